// SPDX-License-Identifier: Apache-2.0
#include "satsurf/bench/bench.h"
#include "satsurf/core/rng.h"
#include "satsurf/ops/concat.h"
#include "satsurf/splat/rasterize.h"

#include <array>
#include <cmath>

namespace satsurf::bench {
namespace {

/// What the network hands to the renderer: three sheets of surfels, each about a pixel wide and
/// seen from its own direction, over rolling ground with blocks of buildings on it.
struct Scene {
  splat::Surfels surfels;
  splat::BasicProjection<float> camera;
  splat::RasterOptions options;
};

Scene make_scene(Index P, Index side) {
  const Index sheet = P / 3,
              row = static_cast<Index>(std::lround(std::sqrt(static_cast<double>(sheet))));
  const double gsd = 0.5, extent = gsd * static_cast<double>(side),
               step = extent / static_cast<double>(row);
  Scene s;
  s.options.height = s.options.width = side;
  Tensor means({P, 3}), quats({P, 4}), scales({P, 2}), opacity({P}), colours({P, 3});
  Rng rng(7);
  for (Index p = 0; p < P; ++p) {
    const Index view = p / sheet < 3 ? p / sheet : 2, i = p - view * sheet;
    // horizontal metres per metre of height
    const double tilt = 0.15 * (static_cast<double>(view) - 1);
    double x = (static_cast<double>(i % row) + 0.5) * step - extent / 2;
    const double y = extent / 2 - (static_cast<double>(i / row) + 0.5) * step;
    const bool building = std::sin(x / 9) * std::sin(y / 11) > 0.4;
    const double z =
        3 * std::sin(x / 40) + 2 * std::cos(y / 30) + (building ? 15 : 0) + 0.3 * rng.normal();
    x += tilt * z;
    const std::array<double, 3> mean{x, y, z};
    for (std::size_t c = 0; c < 3; ++c) {
      means[3 * p + static_cast<Index>(c)] = static_cast<float>(mean[c]);
      colours[3 * p + static_cast<Index>(c)] = static_cast<float>(rng.uniform());
    }
    quats[4 * p] = 1;
    for (Index c = 1; c < 4; ++c) quats[4 * p + c] = static_cast<float>(0.15 * rng.normal());
    for (Index c = 0; c < 2; ++c)
      scales[2 * p + c] = static_cast<float>(gsd * rng.uniform(0.5, 0.8));
    opacity[p] = static_cast<float>(rng.uniform(0.4, 0.9));
  }
  s.surfels = {Var(means, true),   Var(quats, true),   Var(scales, true),
               Var(opacity, true), Var(colours, true), {}};
  Quadratic camera;
  camera.coeff[0] = {0.5 * static_cast<double>(side) - 0.5, 1 / gsd, 0.05, 0.4};
  camera.coeff[1] = {0.5 * static_cast<double>(side) - 0.5, 0.03, -1 / gsd, -0.5};
  s.camera = splat::project(means, camera);
  return s;
}

/// What must be touched: 13 numbers of a surfel and 6 of its projection; 9 maps. Sorting and
/// blending, which take most of the time, depend on the scene and are not counted.
Cost forward_cost(const benchmark::State& state) {
  return {.bytes = bytes_of(19 * number(state.range(0)) +
                            9 * number(state.range(1)) * number(state.range(1)))};
}
/// The surfels again and their gradients; 5 maps.
Cost backward_cost(const benchmark::State& state) {
  return {.bytes = bytes_of(32 * number(state.range(0)) +
                            5 * number(state.range(1)) * number(state.range(1)))};
}

void splat_fwd(benchmark::State& state) {
  const Scene s = make_scene(state.range(0), state.range(1));
  const NoGrad no_grad;
  time_row(state, forward_cost(state),
           [&] { benchmark::DoNotOptimize(splat::rasterize(s.surfels, s.camera, s.options)); });
}

/// The backward pass alone, through colour, height and opacity.
void splat_bwd(benchmark::State& state) {
  const Scene s = make_scene(state.range(0), state.range(1));
  const Index side = state.range(1);
  const Tensor seed({5, side, side}, 0.1F);
  Var out;
  const auto render = [&] {
    for (Var v :
         {s.surfels.means, s.surfels.quats, s.surfels.scales, s.surfels.opacity, s.surfels.colours})
      v.clear_grad();
    const splat::Render r = splat::rasterize(s.surfels, s.camera, s.options);
    out = concat<float>(
        {r.colour, reshape(r.height, {1, side, side}), reshape(r.alpha, {1, side, side})}, 0);
  };
  time_row(state, backward_cost(state), render, [&] { out.backward(seed); });
}

/// Positions and 2 x 3 Jacobians of all centres.
void splat_project(benchmark::State& state) {
  const Scene s = make_scene(state.range(0), state.range(1));
  Quadratic camera;
  camera.coeff[0] = {128, 2, 0.05, 0.4, 1e-5, 2e-5, 1e-5, 0, 0, 1e-5};
  camera.coeff[1] = {128, 0.03, -2, -0.5, 1e-5, 0, 2e-5, 1e-5, 1e-5, 0};
  time_row(state, {.bytes = bytes_of(11 * number(state.range(0)))}, [&] {
    benchmark::DoNotOptimize(splat::project(s.surfels.means.value(), camera).pixels.data());
  });
}

}  // namespace

void add_splat_rows() {
  const auto add = [](const char* name, void (*row)(benchmark::State&)) {
    benchmark::RegisterBenchmark(name, row)
        ->ArgNames({"surfels", "side"})
        ->Args({65536, 256})
        ->Args({196608, 256})
        ->Args({3145728, 1024});
  };
  add("splat_project", splat_project);
  add("splat_fwd", splat_fwd);
  add("splat_bwd", splat_bwd);
}

}  // namespace satsurf::bench

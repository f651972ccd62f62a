// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/rng.h"
#include "satsurf/ops/concat.h"
#include "satsurf/splat/rasterize.h"

#include <array>
#include <cmath>

#include <benchmark/benchmark.h>

namespace satsurf {
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
    const double tilt =
        0.15 * (static_cast<double>(view) - 1);  // horizontal metres per metre of height
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

void splat_fwd(benchmark::State& state) {
  const Scene s = make_scene(state.range(0), state.range(1));
  const NoGrad no_grad;
  for (auto _ : state) benchmark::DoNotOptimize(splat::rasterize(s.surfels, s.camera, s.options));
  state.SetItemsProcessed(state.iterations() * state.range(0));
}

/// The backward pass alone, through colour, height and opacity.
void splat_bwd(benchmark::State& state) {
  const Scene s = make_scene(state.range(0), state.range(1));
  const Index side = state.range(1);
  const Tensor seed({5, side, side}, 0.1f);
  for (auto _ : state) {
    state.PauseTiming();
    const splat::Render r = splat::rasterize(s.surfels, s.camera, s.options);
    const Var out = concat<float>(
        {r.colour, reshape(r.height, {1, side, side}), reshape(r.alpha, {1, side, side})}, 0);
    state.ResumeTiming();
    out.backward(seed);
    state.PauseTiming();
    for (Var v :
         {s.surfels.means, s.surfels.quats, s.surfels.scales, s.surfels.opacity, s.surfels.colours})
      v.clear_grad();
    state.ResumeTiming();
  }
  state.SetItemsProcessed(state.iterations() * state.range(0));
}

void sizes(benchmark::internal::Benchmark* b) {
  b->ArgNames({"surfels", "side"})->Args({65536, 256})->Args({196608, 256})->Args({3145728, 1024});
  b->UseRealTime()->Unit(benchmark::kMillisecond);
}
BENCHMARK(splat_fwd)->Apply(sizes);
BENCHMARK(splat_bwd)->Apply(sizes);

}  // namespace
}  // namespace satsurf

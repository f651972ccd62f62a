// SPDX-License-Identifier: Apache-2.0
#include "satsurf/bench/bench.h"
#include "satsurf/core/rng.h"
#include "satsurf/reconstruct/fusion.h"

#include <cmath>
#include <numeric>
#include <vector>

namespace satsurf::bench {
namespace {

/// What the views of a place hand to the fusion: whole images of affine cameras that look at ground
/// with blocks of buildings on it, each with heights of its own noise.
struct Views {
  nn::NetworkInput input;
  Tensor heights, means, confidence;
  std::vector<Index> keep;
  reconstruct::FusionGrid grid;
};

Views make_views(Index N, Index side) {
  constexpr double kGsd = 0.5;
  const double centre = 0.5 * number(side - 1);
  const Index P = side * side;
  Views v;
  v.input.z_range = {0, 30};
  v.heights = Tensor({N, side, side});
  v.means = Tensor({N * P, 3});
  v.confidence = Tensor({N, side, side}, 0.8F);
  v.keep.resize(static_cast<std::size_t>(N * P));
  std::iota(v.keep.begin(), v.keep.end(), Index{0});
  const auto lean = [&](Index i) { return 0.3 * (number(i) - 0.5 * number(N - 1)); };
  Rng rng(7);
  for (Index i = 0; i < N; ++i) {
    nn::PosedImage view{{}, Tensor({side, side}, 1.F), {}, {}};
    view.pixel_from_local.coeff[0] = {centre, 1 / kGsd, 0, lean(i) / kGsd};
    view.pixel_from_local.coeff[1] = {centre, 0, -1 / kGsd};
    view.local_from_pixel.coeff[0] = {-centre * kGsd, kGsd, 0, -lean(i)};
    view.local_from_pixel.coeff[1] = {centre * kGsd, 0, -kGsd};
    auto& transfer = v.input.transfer.emplace_back();
    for (Index j = 0; j < N; ++j) {
      Quadratic& q = transfer.emplace_back();
      q.coeff[0] = {0, 1, 0, (lean(j) - lean(i)) / kGsd};
      q.coeff[1] = {0, 0, 1};
    }
    for (Index p = 0; p < P; ++p) {
      const auto x = number(p % side), y = number(p / side);
      const bool building = std::sin(x / 18) * std::sin(y / 22) > 0.4;
      const double z = (building ? 18 : 3) + 0.3 * rng.normal();
      const auto ground = view.local_from_pixel(x, y, z);
      const Index k = i * P + p;
      v.heights[k] = v.means[3 * k + 2] = static_cast<float>(z);
      v.means[3 * k] = static_cast<float>(ground[0]);
      v.means[3 * k + 1] = static_cast<float>(ground[1]);
    }
    v.input.sources.push_back(std::move(view));
  }
  v.grid = {.east = -kGsd * number(side) / 2,
            .north = kGsd * number(side) / 2,
            .step = kGsd,
            .height = side,
            .width = side,
            .footprint = kGsd,
            .interval = kGsd / 0.3};
  return v;
}

/// Weights of all surfels and the surface. Counted are a surfel's 8 numbers and a cell's 2.
void fuse_views(benchmark::State& state) {
  const Index N = state.range(0), side = state.range(1);
  const Views v = make_views(N, side);
  time_row(state, {.bytes = bytes_of((8 * number(N) + 2) * number(side * side))}, [&] {
    const auto evidence = reconstruct::surfel_evidence(v.input, v.heights, v.confidence, v.keep);
    benchmark::DoNotOptimize(reconstruct::fuse_surfels(v.means,
                                                       v.confidence.reshaped({N * side * side}),
                                                       evidence, v.grid)
                                 .heights.data());
  });
}

}  // namespace

void add_fusion_rows() {
  benchmark::RegisterBenchmark("fuse_views", fuse_views)
      ->ArgNames({"views", "side"})
      ->Args({3, 512})
      ->Args({3, 1024});
}

}  // namespace satsurf::bench

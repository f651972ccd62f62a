// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"
#include "satsurf/core/parallel.h"
#include "satsurf/core/rng.h"
#include "satsurf/reconstruct/cell_mode.h"
#include "satsurf/reconstruct/fusion.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <functional>
#include <numeric>
#include <vector>

#include "tests/affine_scene.h"
#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::reconstruct;

namespace {

constexpr Index S = 48, P = S * S;

bool same_bits(const Tensor& a, const Tensor& b) {
  return a.shape() == b.shape() &&
         std::memcmp(a.data(), b.data(), static_cast<std::size_t>(a.count()) * sizeof(float)) == 0;
}

/// Three views of a surface z(x, y), from straight above and from two sides, and what each finds in
/// its pixels: the highest point on the ray.
struct MadeUp {
  explicit MadeUp(const std::function<double(double, double)>& surface)
      : input(test::affine_scene(S, {{0, 0}, {1, 0}, {-1, 0}}, -5, 10,
                                 [](double, double) { return 0.0; })) {
    for (Index k = 0; k < 3 * P; ++k) {
      double z = 10;
      for (; z > -5; z -= 0.05) {
        const auto ground = place(k, z);
        if (surface(ground[0], ground[1]) >= z) break;
      }
      heights[k] = static_cast<float>(z);
    }
  }
  std::array<double, 2> place(Index k, double z) const {
    return input.sources[static_cast<std::size_t>(k / P)].local_from_pixel(
        static_cast<double>(k % S), static_cast<double>(k % P / S), z);
  }
  FusedSurface fused() const {
    std::vector<Index> keep(static_cast<std::size_t>(3 * P));
    std::iota(keep.begin(), keep.end(), Index{0});
    Tensor means({3 * P, 3});
    for (Index k = 0; k < 3 * P; ++k) {
      const auto ground = place(k, static_cast<double>(heights[k]));
      means[3 * k] = static_cast<float>(ground[0]),
                means[3 * k + 1] = static_cast<float>(ground[1]);
      means[3 * k + 2] = heights[k];
    }
    return fuse_surfels(means, confidence.reshaped({3 * P}),
                        surfel_evidence(input, heights, confidence, keep), grid);
  }
  float at(const FusedSurface& s, double x, double y) const {
    return s.heights[static_cast<Index>((grid.north - y) / grid.step) * grid.width +
                     static_cast<Index>((x - grid.east) / grid.step)];
  }

  nn::NetworkInput input;
  Tensor heights{Shape{3, S, S}}, confidence{Shape{3, S, S}, 0.8f};
  FusionGrid grid{.east = -12,
                  .north = 12,
                  .step = 0.5,
                  .height = S,
                  .width = S,
                  .footprint = 0.5,
                  .interval = 0.75};
};

/// A square roof of 8 m on level ground.
double house(double x, double y) { return std::abs(x) < 4 && std::abs(y) < 4 ? 6 : 0; }

/// The mode as its definition reads.
CellMode slow_mode(std::vector<CellCandidate> c, double b) {
  std::stable_sort(c.begin(), c.end(), [](const auto& p, const auto& q) { return p.z < q.z; });
  double best = 0, mode = 0, all = 0, weight = 0, z = 0, sure = 0;
  for (const auto& p : c) {
    double density = 0;
    for (const auto& q : c) density += q.weight * std::max(0.0, 1 - std::abs(p.z - q.z) / b);
    if (density > best * (1 + 1e-6)) best = density, mode = p.z;
  }
  for (const auto& p : c) {
    all += p.weight;
    if (std::abs(p.z - mode) > b) continue;
    weight += p.weight, z += p.weight * p.z, sure += p.weight * p.confidence;
  }
  return {z / weight, sure / weight * weight / all};
}

}  // namespace

TEST_CASE("the densest mode is what its definition says") {
  Rng rng(3);
  for (int trial = 0; trial < 300; ++trial) {
    CAPTURE(trial);
    std::vector<CellCandidate> candidates;
    const int count = 1 + trial % 40;
    for (int k = 0; k < count; ++k)
      candidates.push_back({1000 + rng.uniform(0, trial % 3 == 0 ? 1 : 12), rng.uniform(0.01, 1),
                            rng.uniform(0, 1)});
    const CellMode slow = slow_mode(candidates, 0.9), fast = densest_mode(candidates, 0.9);
    CHECK(fast.height == doctest::Approx(slow.height).epsilon(1e-9));
    CHECK(fast.confidence == doctest::Approx(slow.confidence).epsilon(1e-9));
  }
}

TEST_CASE("of two modes of one density the lower is taken, and none of none") {
  std::vector<CellCandidate> two{{9, 0.5, 1}, {2, 0.5, 1}}, none;
  CHECK(densest_mode(two, 1).height == 2);
  CHECK(densest_mode(two, 1).confidence == 0.5);
  two.push_back({9.5, 0.1, 1});
  CHECK(densest_mode(two, 1).height > 9);
  CHECK(std::isnan(densest_mode(none, 1).height));
}

TEST_CASE("one view of three that is wrong high does not lift the surface") {
  MadeUp made([](double x, double) { return x < 0 ? 0.0 : 3.0; });
  for (Index y = 16; y < 32; ++y)
    for (Index x = 8; x < 16; ++x) made.heights[2 * P + y * S + x] = 7;
  const FusedSurface fused = made.fused();
  // the third view's points lie 3.5 m east of what the pixels see at z = 0
  for (double x = -8; x < 4; x += 0.5) {
    if (std::abs(x) < 1.5) continue;
    CAPTURE(x);
    CHECK(std::abs(made.at(fused, x + 0.25, 0.25) - (x < 0 ? 0 : 3)) < 0.2f);
  }
  // and is no part of what is kept
  for (const Index k : fused.kept) CHECK(made.heights[k] < 6.5f);
  CHECK(std::ssize(fused.kept) < 3 * P - 100);
}

TEST_CASE("contradiction takes weight and hiding does not") {
  MadeUp made([](double, double) { return 0.0; });
  const Index middle = 24 * S + 24;
  const std::vector<Index> keep{middle};
  const auto weight = [&] {
    return surfel_evidence(made.input, made.heights, made.confidence, keep).weight[0];
  };
  CHECK(weight() == doctest::Approx(0.8));
  made.heights[middle] = 3;  // what the others see through
  CHECK(weight() == doctest::Approx(0.8 / (1 + 2 * 1.6)));
  made.heights[middle] = -3;  // under what they see
  CHECK(weight() == doctest::Approx(0.8));
}

TEST_CASE("heights that agree in other views are counted") {
  MadeUp made([](double, double) { return 0.0; });
  const Index middle = 24 * S + 24;
  const auto counts = [&](const std::vector<Index>& keep) {
    const auto evidence = surfel_evidence(made.input, made.heights, made.confidence, keep);
    return std::array{evidence.compared, evidence.agreed};
  };
  CHECK(counts({middle}) == std::array<Index, 2>{2, 2});
  CHECK(counts({middle, P + middle}) == std::array<Index, 2>{4, 4});
  made.heights[middle] = 3;
  CHECK(counts({middle}) == std::array<Index, 2>{2, 0});
  CHECK(counts({}) == std::array<Index, 2>{0, 0});
}

TEST_CASE("a cell that no surfel reaches is a hole") {
  MadeUp made([](double, double) { return 0.0; });
  for (Index y = 20; y < 28; ++y)
    for (Index x = 20; x < 28; ++x)
      for (Index v = 0; v < 3; ++v) made.confidence[v * P + y * S + x] = 0;
  const FusedSurface fused = made.fused();
  Index holes = 0;
  for (Index i = 0; i < P; ++i) {
    CHECK(std::isnan(fused.heights[i]) == std::isnan(fused.confidence[i]));
    holes += std::isnan(fused.heights[i]);
  }
  CHECK(holes >= 6 * 6);
  CHECK(holes <= 8 * 8);
  CHECK(std::isnan(made.at(fused, 0.1, 0.1)));
}

TEST_CASE("a wall moves by no more than a cell, at any resolution") {
  for (const double step : {0.25, 0.5, 1.0, 1.3}) {
    CAPTURE(step);
    MadeUp made(house);
    made.grid.step = step;
    made.grid.height = made.grid.width = static_cast<Index>(24 / step);
    const FusedSurface fused = made.fused();
    const double near = std::max(step, 0.5);
    for (double y = -3; y < 3; y += 0.3)
      for (double x = -9; x < 9; x += 0.1) {
        if (std::abs(std::abs(x) - 4) <= 1.5 * near) continue;
        CAPTURE(x);
        CAPTURE(y);
        CHECK(std::abs(static_cast<double>(made.at(fused, x, y)) - house(x, y)) < 0.2);
      }
  }
}

TEST_CASE("fusion gives the same bits on any number of threads") {
  MadeUp made(house);
  Rng rng(5);
  for (float& z : made.heights.values()) z += static_cast<float>(rng.normal());
  set_threads(1);
  const FusedSurface one = made.fused();
  set_threads(4);
  const FusedSurface four = made.fused();
  set_threads(0);
  CHECK(same_bits(one.heights, four.heights));
  CHECK(same_bits(one.confidence, four.confidence));
  CHECK(one.kept == four.kept);
}

TEST_CASE("surfels without their evidence are refused") {
  CHECK_THROWS_AS(fuse_surfels(Tensor({3, 3}), Tensor({3}), {Tensor({2}), Tensor({3, 2})},
                               {.step = 1, .height = 2, .width = 2, .footprint = 1, .interval = 1}),
                  ShapeError);
}

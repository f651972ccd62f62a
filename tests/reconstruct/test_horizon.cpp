// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"
#include "satsurf/reconstruct/horizon.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::reconstruct;

namespace {

constexpr Index H = 40, W = 60;
constexpr double kStep = 0.5;

/// A block of 8 x 12 cells, 10 m high, on level ground with an unknown corner.
Tensor block() {
  Tensor z({H, W});
  for (Index i = 0; i < H; ++i)
    for (Index j = 0; j < W; ++j) {
      z[i * W + j] = i >= 16 && i < 24 && j >= 24 && j < 36 ? 10.F : 0.F;
      if (i < 5 && j < 5) z[i * W + j] = std::nanf("");
    }
  return z;
}

/// The definition, in small steps along the line over steps of the surface.
double walked(const Tensor& z, double x, double y, double east, double north) {
  double most = -INFINITY;
  for (double t = 0.01; t < 60; t += 0.01) {
    const auto j = static_cast<Index>(std::floor((x + t * east) / kStep)),
               i = static_cast<Index>(std::floor((y - t * north) / kStep));
    if (i < 0 || j < 0 || i >= H || j >= W) break;
    const double dx = std::abs((static_cast<double>(j) + 0.5) * kStep - x),
                 dy = std::abs((static_cast<double>(i) + 0.5) * kStep - y);
    if (std::max(dx, dy) < kStep / 2) continue;  // its own cell
    if (std::isfinite(z[i * W + j])) most = std::max(most, static_cast<double>(z[i * W + j]) - t);
  }
  return most;
}

}  // namespace

TEST_CASE("a horizon is what a walk along the sight lines meets") {
  const Tensor z = block();
  for (const auto& [east, north] :
       {std::pair(0.6, 0.0), {-0.4, 0.1}, {0.2, 0.5}, {-0.3, -0.5}, {0.25, -0.25}, {0.0, -0.7}}) {
    CAPTURE(east);
    CAPTURE(north);
    const Tensor found = sight_horizon(z, kStep, {east, north});
    Index alike = 0, hidden = 0, both = 0;
    double apart = 0;
    for (Index i = 0; i < H; ++i)
      for (Index j = 0; j < W; ++j) {
        const double known = walked(z, (static_cast<double>(j) + 0.5) * kStep,
                                    (static_cast<double>(i) + 0.5) * kStep, east, north),
                     h = static_cast<double>(found[i * W + j]);
        const bool hides = known > 0.5, says = h > 0.5;
        hidden += hides ? 1 : 0;
        both += hides && says ? 1 : 0;
        alike += hides == says ? 1 : 0;
        if (hides && says) apart += std::abs(h - known);  // at silhouettes it is linear, not a step
      }
    CHECK(hidden > 40);
    CHECK(both > 0.8 * static_cast<double>(hidden));
    CHECK(alike > 0.98 * H * W);
    CHECK(apart / static_cast<double>(both) < 1.5);
  }
}

TEST_CASE("a horizon by hand") {
  Tensor z({1, 6});
  z[4] = 7;
  // 0.5 m of ground per metre: from cell to cell of 1 m two metres
  const Tensor east = sight_horizon(z, 1, {0.5, 0});
  const float from_east[] = {-1, 1, 3, 5, -2, -std::numeric_limits<float>::infinity()};
  for (Index j = 0; j < 6; ++j) CHECK(east[j] == from_east[j]);
  const Tensor west = sight_horizon(z, 1, {-0.5, 0});
  CHECK(west[0] == -std::numeric_limits<float>::infinity());
  CHECK(west[4] == -2);
  CHECK(west[5] == 5);
  const Tensor above = sight_horizon(z, 1, {0, 0});
  for (const float h : above.values()) CHECK(h < -1e30F);
  CHECK_THROWS_AS(sight_horizon(Tensor({2, 2, 2}), 1, {0, 0}), ShapeError);
}

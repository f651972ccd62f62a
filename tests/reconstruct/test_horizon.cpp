// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/core/rng.h"
#include "satsurf/reconstruct/horizon.h"

#include <array>
#include <cmath>
#include <cstring>
#include <limits>

#include <doctest/doctest.h>

using namespace satsurf;
using reconstruct::horizon;

namespace {

/// Cell by cell along the straight line to the camera, which passes through the nearest cell of
/// every row or column, whichever it crosses more of.
double slow_horizon(const Tensor& surface, double step, const std::array<double, 2>& to_camera,
                    Index row, Index col) {
  const double r = -to_camera[1] / step, c = to_camera[0] / step,
               most = std::max(std::abs(r), std::abs(c));
  double highest = -std::numeric_limits<double>::infinity();
  for (double n = 1;; ++n) {
    // a half is rounded as the chains do, which do not begin here: nothing below hits one
    const auto i = row + std::lround(n * r / most), j = col + std::lround(n * c / most);
    if (i < 0 || j < 0 || i >= surface.dim(0) || j >= surface.dim(1)) return highest;
    if (const float z = surface[i * surface.dim(1) + j]; std::isfinite(z))
      highest = std::max(highest, static_cast<double>(z) - n / most);
  }
}

}  // namespace

TEST_CASE("a tower hides the ground behind it as far as its shadow would fall") {
  // 10 m high, 3 cells of 2 m wide; the camera stands in the east, half a metre per metre
  Tensor surface({9, 40});
  for (Index i = 3; i < 6; ++i)
    for (Index j = 30; j < 33; ++j) surface[i * 40 + j] = 10;
  const Tensor z = horizon(surface, 2, {0.5, 0});
  CHECK(std::isinf(z[4 * 40 + 39]));                 // nothing is between it and the camera
  CHECK(z[4 * 40 + 29] == doctest::Approx(10 - 4));  // one cell behind, 2 m, is 4 m of height
  CHECK(z[4 * 40 + 28] == doctest::Approx(10 - 8));
  CHECK(z[4 * 40 + 27] < 0);                         // the ground is seen again
  CHECK(z[2 * 40 + 29] < 0);                         // beside the tower
  CHECK(z[4 * 40 + 31] == doctest::Approx(10 - 4));  // the tower's own roof hides what is below it
  // the other way round, and along the other axis
  CHECK(horizon(surface, 2, {-0.5, 0})[4 * 40 + 33] == doctest::Approx(10 - 4));
  CHECK(horizon(surface, 2, {0, 0.5})[6 * 40 + 31] == doctest::Approx(10 - 4));
  CHECK(horizon(surface, 2, {0, -0.5})[2 * 40 + 31] == doctest::Approx(10 - 4));
}

TEST_CASE("horizons in all directions are those along straight lines, but for half a cell") {
  Rng rng(7);
  constexpr Index H = 23, W = 31;
  Tensor surface({H, W});
  for (float& z : surface.values())
    z = rng.uniform(0, 1) < 0.1 ? std::nanf("") : static_cast<float>(rng.uniform(0, 20));
  // along rows, columns and diagonals there is one chain alone: the same; in between lines stray
  for (const std::array<double, 2>& camera :
       {std::array{0.4, 0.0}, {-0.4, 0.0}, {0.0, 0.3}, {0.0, -0.3}, {0.25, 0.25}, {-0.25, 0.25}}) {
    CAPTURE(camera[0]);
    CAPTURE(camera[1]);
    const Tensor z = horizon(surface, 0.5, camera);
    for (Index i = 0; i < H; ++i)
      for (Index j = 0; j < W; ++j) {
        const double slow = slow_horizon(surface, 0.5, camera, i, j);
        const auto fast = static_cast<double>(z[i * W + j]);
        if (std::isinf(slow))
          REQUIRE(std::isinf(fast));
        else
          REQUIRE(fast == doctest::Approx(slow).epsilon(1e-5));
      }
  }
  // a ridge across the line to the camera is as high seen from anywhere
  Tensor ridge({H, W});
  for (Index i = 0; i < H; ++i) ridge[i * W + 20] = 8;
  for (const double north : {-0.3, -0.1, 0.05, 0.2}) {
    const Tensor z = horizon(ridge, 0.5, {0.4, north});
    for (Index i = 8; i < 15; ++i)
      for (Index j = 12; j < 20; ++j) {
        CAPTURE(north);
        const double expected = 8 - static_cast<double>(20 - j) * 0.5 / 0.4;
        REQUIRE(static_cast<double>(z[i * W + j]) == doctest::Approx(std::max(expected, -1.25)));
      }
  }
}

TEST_CASE("horizons: steep cameras, holes and threads") {
  Tensor surface({64, 70}, std::nanf(""));
  const Tensor unknown = horizon(surface, 0.5, {0.3, 0.1});
  for (const float z : unknown.values()) REQUIRE(std::isinf(z));
  for (float& z : surface.values()) z = 5;
  const Tensor steep = horizon(surface, 0.5, {0, 0});
  for (const float z : steep.values()) REQUIRE(std::isinf(z));
  Rng rng(3);
  for (float& z : surface.values()) z = static_cast<float>(rng.uniform(0, 9));
  const Tensor all = horizon(surface, 0.5, {-0.2, 0.33});
  set_threads(1);
  const Tensor one = horizon(surface, 0.5, {-0.2, 0.33});
  set_threads(0);
  CHECK(std::memcmp(all.data(), one.data(), sizeof(float) * 64 * 70) == 0);
}

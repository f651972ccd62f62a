// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/quadratic.h"
#include "satsurf/core/rng.h"

#include <doctest/doctest.h>

using namespace satsurf;

namespace {

Quadratic sample(std::uint64_t seed) {
  Rng rng(seed);
  Quadratic q;
  for (double& o : q.offset) o = rng.uniform(-50, 50);
  for (double& s : q.scale) s = rng.uniform(20, 90);
  for (auto& row : q.coeff)
    for (double& c : row) c = rng.uniform(-30, 30);
  q.rms = 0.25;
  q.max = 0.75;
  return q;
}

/// The sum of the ten monomials, term by term.
double by_hand(const Quadratic& q, std::size_t k, double x, double y, double z) {
  const double a = (x - q.offset[0]) / q.scale[0], b = (y - q.offset[1]) / q.scale[1],
               c = (z - q.offset[2]) / q.scale[2];
  const double monomials[] = {1, a, b, c, a * a, a * b, a * c, b * b, b * c, c * c};
  double sum = 0;
  for (std::size_t m = 0; m < 10; ++m) sum += q.coeff[k][m] * monomials[m];
  return sum;
}

}  // namespace

TEST_CASE("quadratic: values are the sum of the monomials") {
  for (std::uint64_t seed = 0; seed < 5; ++seed) {
    const Quadratic q = sample(seed);
    const auto out = q(13.5, -71.25, 8.75);
    for (std::size_t k = 0; k < 2; ++k)
      CHECK(out[k] == doctest::Approx(by_hand(q, k, 13.5, -71.25, 8.75)).epsilon(1e-12));
  }
}

TEST_CASE("quadratic: a line along z has the map's values") {
  const Quadratic q = sample(3);
  const QuadraticLine line = q.along_z(13.5, -71.25);
  for (const double z : {-300.0, 0.0, 8.75, 120.5})
    for (std::size_t k = 0; k < 2; ++k)
      CHECK(line(z)[k] == doctest::Approx(by_hand(q, k, 13.5, -71.25, z)).epsilon(1e-12));
}

TEST_CASE("quadratic: the jacobian is that of differences") {
  const Quadratic q = sample(9);
  const std::array<double, 3> p{13.5, -71.25, 8.75};
  const auto j = q.jacobian(p[0], p[1], p[2]);
  for (std::size_t i = 0; i < 3; ++i) {
    auto up = p, down = p;
    up[i] += 0.5;  // central differences of a quadratic are exact for any step
    down[i] -= 0.5;
    const auto a = q(up[0], up[1], up[2]), b = q(down[0], down[1], down[2]);
    for (std::size_t k = 0; k < 2; ++k)
      CHECK(j[k][i] == doctest::Approx(a[k] - b[k]).epsilon(1e-9));
  }
}

TEST_CASE("quadratic: rescaled pixels mean the same points") {
  const Quadratic full = sample(4);
  const double in = 4, out = 2;
  const Quadratic coarse = rescale_pixels(full, in, out);
  for (const auto& [x, y, z] : {std::array{0.0, 0.0, 0.0}, std::array{10.25, -3.5, 7.0}}) {
    // x_s = (x + 0.5) / s - 0.5, so x = s (x_s + 0.5) - 0.5
    const auto wanted = full(in * (x + 0.5) - 0.5, in * (y + 0.5) - 0.5, z);
    const auto got = coarse(x, y, z);
    for (std::size_t k = 0; k < 2; ++k)
      CHECK(got[k] == doctest::Approx((wanted[k] + 0.5) / out - 0.5).epsilon(1e-12));
  }
  CHECK(coarse.rms == 0.125);
  CHECK(coarse.max == 0.375);
  const Quadratic same = rescale_pixels(full, 1, 1);
  CHECK(same(3, 4, 5)[0] == doctest::Approx(full(3, 4, 5)[0]).epsilon(1e-14));
}

TEST_CASE("quadratic: shifted origins mean the same points") {
  const Quadratic q = sample(6);
  const Quadratic moved = shift_pixels(q, {128, -64}, {32, 7});
  const auto wanted = q(200, 10, 5), got = moved(200 - 128, 10 + 64, 5);
  CHECK(got[0] == doctest::Approx(wanted[0] - 32).epsilon(1e-12));
  CHECK(got[1] == doctest::Approx(wanted[1] - 7).epsilon(1e-12));
  CHECK(moved.rms == q.rms);
}

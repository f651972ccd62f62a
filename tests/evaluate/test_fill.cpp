// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/core/rng.h"
#include "satsurf/evaluate/fill.h"

#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <tuple>

#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::evaluate;

namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

/// Looks at every known cell for every unknown one.
Tensor filled_slowly(const Tensor& z) {
  const Index H = z.dim(0), W = z.dim(1);
  Tensor out = z.clone();
  for (Index i = 0; i < H; ++i)
    for (Index j = 0; j < W; ++j) {
      if (std::isfinite(z[i * W + j])) continue;
      std::array<std::tuple<Index, Index, Index>, 4> best;  // distance^2, columns away, cell
      best.fill({-1, 0, 0});
      for (Index r = 0; r < H; ++r)
        for (Index c = 0; c < W; ++c) {
          if (!std::isfinite(z[r * W + c])) continue;
          const Index east = c - j, north = i - r;
          const std::size_t q = north > 0 && east >= 0   ? 0
                                : east > 0 && north <= 0 ? 1
                                : north < 0 && east <= 0 ? 2
                                                         : 3;
          const std::tuple<Index, Index, Index> here{east * east + north * north, std::abs(east),
                                                     r * W + c};
          if (std::get<0>(best[q]) < 0 || here < best[q]) best[q] = here;
        }
      double sum = 0, weight = 0;
      for (const auto& [square, columns, cell] : best) {
        if (square < 0) continue;
        const double w = 1 / static_cast<double>(square);
        sum += w * static_cast<double>(z[cell]), weight += w;
      }
      if (weight > 0) out[i * W + j] = static_cast<float>(sum / weight);
    }
  return out;
}

/// Heights of which `share` are unknown.
Tensor holed(Index H, Index W, double share, std::uint64_t seed) {
  Rng rng(seed);
  Tensor z({H, W});
  for (float& v : z.values()) {
    v = static_cast<float>(rng.uniform() * 30 - 10);
    if (rng.uniform() < share) v = kNan;
  }
  return z;
}

bool same_bits(const Tensor& a, const Tensor& b) {
  return a.shape() == b.shape() &&
         std::memcmp(a.data(), b.data(), static_cast<std::size_t>(a.count()) * sizeof(float)) == 0;
}

}  // namespace

TEST_CASE("filled: by hand") {
  SUBCASE("weights are 1 / distance^2") {
    const Tensor z = filled(Tensor::from({1, 4}, {1, kNan, kNan, 4}));
    CHECK(z[0] == 1);
    CHECK(z[1] == doctest::Approx((1.0 + 4.0 / 4) / 1.25));
    CHECK(z[2] == doctest::Approx((1.0 / 4 + 4.0) / 1.25));
    CHECK(z[3] == 4);
    const Tensor down = filled(Tensor::from({4, 1}, {1, kNan, kNan, 4}));
    for (Index k = 0; k < 4; ++k) CHECK(down[k] == z[k]);
  }
  SUBCASE("one cell of each quadrant") {
    // of the centre: north 3, east 5, south 7, west 9 at distance 1; corners are farther
    const Tensor z = filled(Tensor::from({3, 3}, {100, 3, 100, 9, kNan, 5, 100, 7, 100}));
    CHECK(z[4] == doctest::Approx(6));
  }
  SUBCASE("the nearest, not the first") {
    // of the cell in the corner all lie in one quadrant: squares 9, 5 and 8
    Tensor z({4, 4}, kNan);
    z[3] = 1, z[4 + 2] = 2, z[2 * 4 + 2] = 3;
    CHECK(filled(z)[0] == 2);
  }
  SUBCASE("one known cell is everywhere") {
    Tensor z({5, 7}, kNan);
    z[2 * 7 + 3] = -4.5f;
    const Tensor all = filled(z);
    for (const float v : all.values()) REQUIRE(v == doctest::Approx(-4.5));
  }
  SUBCASE("nothing known stays so") {
    const Tensor none = filled(Tensor({2, 3}, kNan));
    for (const float v : none.values()) REQUIRE(std::isnan(v));
  }
  SUBCASE("the argument is left alone") {
    const Tensor z = Tensor::from({1, 3}, {1, kNan, 3});
    CHECK(filled(z)[1] == doctest::Approx(2));
    CHECK(std::isnan(z[1]));
  }
  SUBCASE("rank") {
    CHECK_THROWS_WITH_AS(filled(Tensor({3})), "filled: z has shape [3], expected [H W]",
                         ShapeError);
  }
}

TEST_CASE("filled: equals the search of every cell") {
  for (const auto& [H, W, share] : {std::tuple<Index, Index, double>{13, 17, 0.5},
                                    {17, 13, 0.95},
                                    {1, 19, 0.8},
                                    {23, 1, 0.8},
                                    {31, 29, 0.99},
                                    {40, 41, 0.997},
                                    {6, 5, 0}}) {
    CAPTURE(H);
    CAPTURE(share);
    const Tensor z = holed(H, W, share, 5), fast = filled(z), slow = filled_slowly(z);
    for (Index k = 0; k < z.count(); ++k) {
      CAPTURE(k);
      REQUIRE(std::isfinite(fast[k]));
      REQUIRE(fast[k] == slow[k]);
    }
  }
}

TEST_CASE("filled: the same on any number of threads") {
  const Tensor z = holed(61, 43, 0.9, 8);
  const int before = threads();
  set_threads(1);
  const Tensor one = filled(z);
  set_threads(2);
  const Tensor two = filled(z);
  set_threads(before);
  CHECK(same_bits(one, two));
}

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/reconstruct/trust.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "tests/affine_scene.h"
#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::reconstruct;

namespace {

constexpr Index S = 32, P = S * S;

Index pixel(Index x, Index y) { return y * S + x; }

/// Two views of level ground. A point z metres up is seen z pixels further to the right by the
/// second than by the first, and heights from -5 to 5 m are searched.
struct MadeUp {
  nn::NetworkInput input =
      test::affine_scene(S, {{0, 0}, {1, 0}}, -5, 5, [](double, double) { return 0.0; });
  Tensor heights{Shape{2, S, S}};

  std::vector<Index> kept(const std::optional<Ground>& tile = {}) const {
    Tensor means({2 * P, 3});
    for (Index k = 0; k < 2 * P; ++k) {
      const double z = static_cast<double>(heights[k]);
      const auto ground = input.sources[static_cast<std::size_t>(k / P)].local_from_pixel(
          static_cast<double>(k % S), static_cast<double>(k % P / S), z);
      means[3 * k] = static_cast<float>(ground[0]);
      means[3 * k + 1] = static_cast<float>(ground[1]);
      means[3 * k + 2] = heights[k];
    }
    return trusted_surfels(input, means, heights, tile);
  }
  bool keeps(Index surfel) const {
    const std::vector<Index> all = kept();
    return std::binary_search(all.begin(), all.end(), surfel);
  }
};

}  // namespace

TEST_CASE("surfels on which the views agree are kept") {
  const MadeUp made;
  CHECK(made.kept().size() == 2 * P);  // level ground: every pixel is the other's
}

TEST_CASE("near an image's end a contradicted surfel goes and an agreeing one stays") {
  MadeUp made;
  // At 5 m this pixel's point has left the second image, so that height cannot be compared.
  const Index rim = pixel(29, 10);
  CHECK(made.keeps(rim));
  made.heights[P + rim] = 2.4f;
  CHECK(made.keeps(rim));
  made.heights[P + rim] = 2.6f;
  CHECK_FALSE(made.keeps(rim));
  made.heights[P + rim] = -2.6f;
  CHECK_FALSE(made.keeps(rim));
  // Four pixels further in every height is compared by the network itself, which has decided.
  const Index inner = pixel(25, 10);
  made.heights[P + inner] = 2.6f;
  CHECK(made.keeps(inner));
}

TEST_CASE("a surfel that no other view can see goes") {
  MadeUp made;
  const Index rim = pixel(29, 10);
  made.heights[rim] = 4;  // falls on column 33 of 32
  CHECK_FALSE(made.keeps(rim));
  made.heights[rim] = 2;  // on the last column
  CHECK(made.keeps(rim));
}

TEST_CASE("invalid pixels neither are kept nor bear others out") {
  MadeUp made;
  const Index p = pixel(12, 12);
  made.input.sources[0].valid[p] = 0;
  CHECK_FALSE(made.keeps(p));
  CHECK_FALSE(made.keeps(P + p));  // what it would have compared itself with
  CHECK(made.keeps(pixel(13, 12)));
}

TEST_CASE("a third view is enough") {
  MadeUp two;
  const Index rim = pixel(29, 10);
  two.heights[P + rim] = 5;
  REQUIRE_FALSE(two.keeps(rim));
  nn::NetworkInput three =
      test::affine_scene(S, {{0, 0}, {1, 0}, {0, 1}}, -5, 5, [](double, double) { return 0.0; });
  Tensor heights({3, S, S}), means({3 * P, 3});
  heights[P + rim] = 5;
  const std::vector<Index> kept = trusted_surfels(three, means, heights, {});
  CHECK(std::binary_search(kept.begin(), kept.end(), rim));
}

TEST_CASE("tiles that share an edge share no surfel and lose none") {
  const MadeUp made;
  const double side = 0.5 * S, middle = 0;
  const Ground west{-side, -side, middle, side}, east{middle, -side, side, side};
  const auto a = made.kept(west), b = made.kept(east);
  CHECK(a.size() + b.size() == 2 * P);
  CHECK(a.size() == P);
  std::vector<Index> both;
  std::set_intersection(a.begin(), a.end(), b.begin(), b.end(), std::back_inserter(both));
  CHECK(both.empty());
  CHECK(made.kept(Ground{100, 100, 200, 200}).empty());
}

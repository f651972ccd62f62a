// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"
#include "satsurf/core/rng.h"
#include "satsurf/splat/select.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::splat;

namespace {

/// A gentle slope of 100 m with four surfels a metre, each of a colour that no other has.
Surfels slope() {
  constexpr Index kSide = 200;
  Surfels s{Var(Tensor({kSide * kSide, 3})),        Var(Tensor({kSide * kSide, 4}, 0.5F)),
            Var(Tensor({kSide * kSide, 2}, 0.3F)),  Var(Tensor({kSide * kSide})),
            Var(Tensor({kSide * kSide, 3}, 0.25F)), {}};
  Tensor means = s.means.value(), opacity = s.opacity.value(), colours = s.colours.value();
  Rng rng(4);
  const Tensor random = uniform_tensor<float>({kSide * kSide}, rng, 0.1, 0.9);
  for (Index p = 0; p < kSide * kSide; ++p) {
    const auto x = static_cast<float>(p % kSide) / 2 - 50, y = static_cast<float>(p / kSide) / 2;
    means[3 * p] = x, means[3 * p + 1] = y, means[3 * p + 2] = 0.1F * x;
    opacity[p] = random[p];
    colours[3 * p] = static_cast<float>(p);
  }
  return s;
}

}  // namespace

TEST_CASE("fewer surfels still cover the surface") {
  const Surfels all = slope();
  const Index most = 3000;
  const Surfels few = thinned(all, most);
  const Index P = few.means.value().dim(0);
  CHECK(P <= most);
  CHECK(P > most * 8 / 10);
  const Tensor &means = few.means.value(), &scales = few.scales.value();
  for (Index p = 0; p < P; ++p) {  // each is one of the set, whole
    const auto k = static_cast<Index>(few.colours.value()[3 * p]);
    for (Index i = 0; i < 3; ++i) REQUIRE(means[3 * p + i] == all.means.value()[3 * k + i]);
    REQUIRE(few.opacity.value()[p] == all.opacity.value()[k]);
    REQUIRE(scales[2 * p] == scales[0]);
  }
  // what 3000 are of 100 m by 100 m is a cube of 1.8 m
  CHECK(scales[0] > 0.7F);
  CHECK(scales[0] < 1.3F);
  for (Index k = 0; k < all.means.value().dim(0); k += 37) {
    float nearest = 1e9F;
    for (Index p = 0; p < P; ++p) {
      float square = 0;
      for (Index i = 0; i < 3; ++i) {
        const float d = means[3 * p + i] - all.means.value()[3 * k + i];
        square += d * d;
      }
      nearest = std::min(nearest, square);
    }
    REQUIRE(std::sqrt(nearest) < 2 * 2 * scales[0]);  // in the cube or in one beside it
  }
}

TEST_CASE("of one cube the most opaque is left") {
  Surfels s{Var(Tensor::from({3, 3}, {1, 1, 1, 1.001F, 1, 1, 9, 9, 9})),
            Var(Tensor({3, 4}, 0.5F)),
            Var(Tensor({3, 2}, 0.3F)),
            Var(Tensor::from({3}, {0.2F, 0.8F, 0.1F})),
            Var(Tensor({3, 3}, 0.5F)),
            {}};
  const Surfels two = thinned(s, 2);
  REQUIRE(two.means.value().dim(0) == 2);
  CHECK(two.opacity.value()[0] == 0.8F);
  CHECK(two.opacity.value()[1] == 0.1F);
  CHECK(two.scales.value()[0] == 0.3F);  // the cubes are smaller than the discs
  CHECK(thinned(s, 3).means.value().dim(0) == 3);
  CHECK(thinned(s, 1).means.value().dim(0) == 1);
  CHECK_THROWS_WITH_AS(thinned(s, 0), "thinned: 0 surfels, expected 1 or more", Error);
}

TEST_CASE("sets are joined with the tensors that all of them have") {
  const auto set = [](Index P, float value, Index K) {
    Surfels s{Var(Tensor({P, 3}, value)), Var(Tensor({P, 4}, value)), Var(Tensor({P, 2}, value)),
              Var(Tensor({P}, value)),    Var(Tensor({P, 3}, value)), {}};
    if (K > 0) s.aux = Var(Tensor({P, K}, value));
    return s;
  };
  const Surfels plain = joined<float>({set(2, 1, 0), set(3, 2, 0)});
  CHECK(plain.aux.empty());
  REQUIRE(plain.means.shape() == Shape{5, 3});
  CHECK(plain.means.value()[5] == 1);
  CHECK(plain.means.value()[6] == 2);
  const Surfels more = joined<float>({set(2, 1, 4), set(3, 2, 4)});
  REQUIRE(more.aux.shape() == Shape{5, 4});
  CHECK(more.aux.value()[8] == 2);
  CHECK_THROWS_WITH_AS(joined<float>({set(2, 1, 4), set(3, 2, 0)}),
                       "joined: 1 of 2 sets have aux, expected all or none", ShapeError);
  CHECK_THROWS_WITH_AS(joined<float>({}), "joined: no sets, expected one or more", ShapeError);
}

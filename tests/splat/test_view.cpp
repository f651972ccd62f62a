// SPDX-License-Identifier: Apache-2.0
#include "satsurf/splat/view.h"

#include <cmath>

#include <doctest/doctest.h>

using namespace satsurf;

TEST_CASE("surface_colours: nothing shines through a surface, and what is none fades") {
  const Tensor alpha = Tensor::from({1, 5}, {1.f, 0.6f, 0.5f, 0.25f, 0.f});
  Tensor colour({3, 1, 5});
  for (Index c = 0; c < 3; ++c)
    for (Index i = 0; i < 5; ++i)
      colour[c * 5 + i] = alpha[i] * 0.2f * static_cast<float>(c + 1);  // over black
  splat::Render render;
  render.colour = Var(colour), render.alpha = Var(alpha);
  const Tensor found = splat::surface_colours(render);
  REQUIRE(found.shape() == Shape{3, 1, 5});
  const float share[] = {1, 1, 1, 0.5f, 0};
  for (Index c = 0; c < 3; ++c)
    for (Index i = 0; i < 5; ++i)
      CHECK(found[c * 5 + i] == doctest::Approx(share[i] * 0.2f * static_cast<float>(c + 1)));
}

TEST_CASE("surface_heights: the median of what is dense, the mean of what is thin") {
  splat::Render render;
  render.alpha = Var(Tensor::from({1, 3}, {0.9f, 0.3f, 0.01f}));
  render.height = Var(Tensor::from({1, 3}, {1.f, 2.f, 3.f}));
  render.median_height = Tensor::from({1, 3}, {4.f, 5.f, 6.f});
  const Tensor z = splat::surface_heights(render);
  CHECK(z[0] == 4);
  CHECK(z[1] == 2);
  CHECK(std::isnan(z[2]));
}

TEST_CASE("surface_heights: the mean where rounding has left more than half of the light") {
  splat::Render render;
  render.alpha = Var(Tensor::from({1, 2}, {0.50000006f, 0.9f}));
  render.height = Var(Tensor::from({1, 2}, {2.f, 1.f}));
  render.median_height = Tensor::from({1, 2}, {std::nanf(""), 4.f});
  const Tensor z = splat::surface_heights(render);
  CHECK(z[0] == 2);
  CHECK(z[1] == 4);
}

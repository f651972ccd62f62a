// SPDX-License-Identifier: Apache-2.0
#include "satsurf/reconstruct/shown_place.h"

#include <limits>
#include <vector>

#include "tests/affine_scene.h"
#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::reconstruct;

TEST_CASE("a guess is shown by two images only if they show the place lower, too") {
  constexpr Index kSide = 101;
  const auto image = [](double slope, double centre) {
    const test::AffineCamera camera{.gsd = 1, .slope_x = slope, .centre = centre};
    nn::PosedImage out{Tensor({3, kSide, kSide}), Tensor({kSide, kSide}, 1.F),
                       camera.local_from_pixel(), camera.pixel_from_local()};
    out.pixel_from_local.coeff[1][0] = 50;
    return out;
  };
  // One looks straight down and shows x from -50 to 50; the other shows x = -40 from 39 m up.
  const std::vector<nn::PosedImage> images{image(0, 50), image(0.5, 20)};
  CHECK(shown_by_two(images, 0, 0, 0));
  CHECK_FALSE(shown_by_two(images, -40, 0, 38));
  CHECK(shown_by_two(images, -40, 0, 60));
  CHECK(shown_by_two_if_lower(images, -40, 0, 60, 10));
  CHECK_FALSE(shown_by_two_if_lower(images, -40, 0, 60, 11));
  CHECK_FALSE(shown_by_two_if_lower(images, -40, 0, 38, 0));
  CHECK(shown_by_two_if_lower(images, 0, 0, 60, 20));
  constexpr double kUnknown = std::numeric_limits<double>::quiet_NaN();
  CHECK_FALSE(shown_by_two_if_lower(images, 0, 0, kUnknown, kUnknown));
}

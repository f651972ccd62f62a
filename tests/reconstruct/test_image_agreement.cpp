// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/core/rng.h"
#include "satsurf/reconstruct/image_agreement.h"
#include "satsurf/reconstruct/warnings.h"

#include <cmath>
#include <limits>
#include <vector>

#include "tests/affine_scene.h"
#include "tests/made_view.h"
#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::reconstruct;
using satsurf::test::AffineCamera;

namespace {

constexpr Index kSide = 100;  // cells of 1 m
constexpr Index kPixels = 400;

/// A plain of 100 m with a wall of 20 m from north to south.
scene::HeightField plain_with_wall() {
  scene::HeightField field{Tensor({kSide, kSide}), -50, 50, 1};
  for (Index i = 0; i < kSide; ++i) field.z[i * kSide + 20] = 20;
  return field;
}

/// What lies on the ground: patches of 1 m, drawn for every date.
Tensor patches(std::uint64_t date) {
  Rng rng(date);
  Tensor out({kSide, kSide});
  for (float& v : out.values()) v = static_cast<float>(rng.uniform());
  return out;
}

/// A plain seen by a camera whose rays run `west` m to the west for each metre they rise, 0.4 m a
/// pixel: gain times its brightness and offset.
nn::PosedImage showing(const Tensor& ground, double west, float gain = 1, float offset = 0) {
  const AffineCamera camera{
      .gsd = 0.4, .slope_x = 2.5 * west, .centre = static_cast<double>(kPixels - 1) / 2};
  nn::PosedImage image{Tensor({3, kPixels, kPixels}), Tensor({kPixels, kPixels}, 1.F),
                       camera.local_from_pixel(), camera.pixel_from_local()};
  for (Index y = 0; y < kPixels; ++y)
    for (Index x = 0; x < kPixels; ++x) {
      const auto p = image.local_from_pixel(static_cast<double>(x), static_cast<double>(y), 0.0);
      const auto j = static_cast<Index>(std::floor(p[0] + 50)),
                 i = static_cast<Index>(std::floor(50 - p[1]));
      if (i < 0 || j < 0 || i >= kSide || j >= kSide) continue;
      for (Index c = 0; c < 3; ++c)
        image.rgb[(c * kPixels + y) * kPixels + x] = offset + gain * ground[i * kSide + j];
    }
  return image;
}

std::vector<nn::PosedImage> three_showing(const Tensor& ground) {
  return {showing(ground, 0.4), showing(ground, -0.3), showing(ground, 0.1)};
}
/// What such images are called.
std::vector<scene::View> three_views() {
  return {test::view_from("a", 0.1), test::view_from("b", -0.1), test::view_from("c", 0)};
}

/// Covers the northern part of the ground with white.
void cloud_over(nn::PosedImage& image, double share) {
  for (Index y = 0; y < kPixels; ++y)
    for (Index x = 0; x < kPixels; ++x)
      if (image.local_from_pixel(static_cast<double>(x), static_cast<double>(y), 0.0)[1] >
          50 - 100 * share)
        for (Index c = 0; c < 3; ++c) image.rgb[(c * kPixels + y) * kPixels + x] = 1;
}

}  // namespace

TEST_CASE("the share of an image that no other confirms") {
  const scene::HeightField field = plain_with_wall();
  const Tensor ground = patches(1);
  std::vector<nn::PosedImage> images{showing(ground, 0.4), showing(ground, -0.3, 0.5F, 0.3F),
                                     showing(ground, 0.1)};

  SUBCASE("nothing, whatever gain and offset, and what a wall hides is not compared") {
    const ImageAgreement agreement = image_agreement(field, images);
    CHECK(agreement.unconfirmed == std::vector<double>{0, 0, 0});
    CHECK(agreement.correlation > 0.8);
  }
  SUBCASE("a cloud, and none but its image is blamed") {
    cloud_over(images[1], 0.3);
    const auto shares = image_agreement(field, images).unconfirmed;
    CHECK(shares[1] == doctest::Approx(0.3).epsilon(0.15));
    CHECK(shares[0] == 0);
    CHECK(shares[2] == 0);
    const OnOneThread one;
    CHECK(image_agreement(field, images).unconfirmed == shares);
  }
  SUBCASE("another ground") {
    images[2] = showing(patches(2), 0.1);
    const auto shares = image_agreement(field, images).unconfirmed;
    CHECK(shares[2] > 0.9);
    CHECK(shares[0] == 0);
  }
  SUBCASE("of two nobody can say which is right, and of three that differ neither") {
    images[1] = showing(patches(2), -0.3);
    CHECK(image_agreement(field, {images[0], images[1]}).unconfirmed == std::vector<double>{0, 0});
    images[2] = showing(patches(3), 0.1);
    CHECK(image_agreement(field, images).unconfirmed == std::vector<double>{0, 0, 0});
  }
  SUBCASE("without a surface there is nothing to say") {
    const scene::HeightField none{Tensor({kSide, kSide}, std::numeric_limits<float>::quiet_NaN()),
                                  -50, 50, 1};
    const ImageAgreement agreement = image_agreement(none, images);
    CHECK(agreement.unconfirmed == std::vector<double>{0, 0, 0});
    CHECK(agreement.correlation == 0);
  }
}

TEST_CASE("images agree less on a surface that is wrong") {
  scene::HeightField field = plain_with_wall();
  const Tensor ground = patches(1);
  const std::vector<nn::PosedImage> images{showing(ground, 0.4), showing(ground, -0.3)};
  const double right = image_agreement(field, images).correlation;
  for (float& z : field.z.values()) z += 3;  // 2 m of parallax
  const double wrong = image_agreement(field, images).correlation;
  CHECK(right > 0.8);
  CHECK(std::abs(wrong) < 0.2);
}

TEST_CASE("ground that only two of three images show") {
  const scene::HeightField field = plain_with_wall();
  std::vector<nn::PosedImage> images = three_showing(patches(1));
  const std::vector<scene::View> views = three_views();
  // 160 m of ground to the images' 100: none lacks a cell, hidden or not
  CHECK(image_agreement(field, images).in_two == 0);
  for (Index y = 0; y < kPixels; ++y)
    for (Index x = 0; x < kPixels; ++x)
      if (images[2].local_from_pixel(static_cast<double>(x), static_cast<double>(y), 0.0)[1] > 20)
        images[2].valid[y * kPixels + x] = 0;
  const ImageAgreement agreement = image_agreement(field, images);
  CHECK(agreement.in_two == doctest::Approx(0.3).epsilon(0.1));
  const auto warnings = image_warnings(agreement, views);
  REQUIRE(warnings.size() == 1);
  CHECK(warnings[0].code == "few_images");
  CHECK(warnings[0].text.find(" of the surface lies in only two of the 3 images") !=
        std::string::npos);
  CHECK(image_agreement(field, {images[0], images[2]}).in_two == 0);  // of two there are no three
}

TEST_CASE("an image with a cloud is warned of by its name") {
  const scene::HeightField field = plain_with_wall();
  std::vector<nn::PosedImage> images = three_showing(patches(1));
  const std::vector<scene::View> views = three_views();
  CHECK(image_warnings(image_agreement(field, images), views).empty());
  cloud_over(images[1], 0.3);
  const auto warnings = image_warnings(image_agreement(field, images), views);
  REQUIRE(warnings.size() == 1);
  CHECK(warnings[0].code == "image_differs");
  CHECK(warnings[0].text.starts_with("b: "));
}

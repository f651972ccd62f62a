// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/core/rng.h"
#include "satsurf/reconstruct/ortho.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "tests/affine_scene.h"
#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::reconstruct;
using satsurf::test::AffineCamera;

namespace {

constexpr Index kSide = 240;  // cells of 0.5 m
constexpr Index kPixels = 300;

scene::HeightField plain() { return {Tensor({kSide, kSide}), -60, 60, 0.5}; }

/// Ground of patches of 4 m: dark, grey and bright.
float ground_at(double x, double y) {
  static const std::vector<float> patches = [] {
    Rng rng(7);
    std::vector<float> out(64 * 64);
    for (float& v : out) v = static_cast<float>(0.25 + 0.2 * rng.uniform());
    return out;
  }();
  const auto patch = [](double m) {
    return static_cast<std::size_t>(std::clamp(std::floor(m / 4) + 32, 0.0, 63.0));
  };
  return patches[patch(y) * 64 + patch(x)];
}

/// A plain seen by a camera whose rays run `west` m to the west for each metre they rise, 0.5 m a
/// pixel: gain times the ground and offset, and a white disc.
/// radius  m
nn::PosedImage showing(double west, float gain = 1, float offset = 0, double radius = 0) {
  const AffineCamera camera{
      .gsd = 0.5, .slope_x = 2 * west, .centre = static_cast<double>(kPixels - 1) / 2};
  nn::PosedImage image{Tensor({3, kPixels, kPixels}), Tensor({kPixels, kPixels}, 1.F),
                       camera.local_from_pixel(), camera.pixel_from_local()};
  for (Index i = 0; i < kPixels * kPixels; ++i) {
    const auto p = image.local_from_pixel(static_cast<double>(i % kPixels),
                                          static_cast<double>(i / kPixels), 0.0);
    const float v = std::hypot(p[0], p[1]) < radius ? 0.96F : offset + gain * ground_at(p[0], p[1]);
    for (Index c = 0; c < 3; ++c) image.rgb[c * kPixels * kPixels + i] = v;
  }
  return image;
}

std::vector<Index> chosen(const std::vector<nn::PosedImage>& images) {
  return find_visibility(plain(), images, exposures_of(images, 0)).best;
}

/// Share of the cells within some metres of the middle, or beyond, that an image gives.
double share(const std::vector<Index>& best, Index image, double radius, bool within) {
  double all = 0, from = 0;
  for (Index i = 0; i < kSide * kSide; ++i) {
    const double x = -60 + (static_cast<double>(i % kSide) + 0.5) * 0.5,
                 y = 60 - (static_cast<double>(i / kSide) + 0.5) * 0.5;
    if ((std::hypot(x, y) < radius) != within) continue;
    all += 1, from += best[static_cast<std::size_t>(i)] == image ? 1 : 0;
  }
  return from / all;
}

}  // namespace

TEST_CASE("a cloud in the steepest image gives no colour, whatever the others' light") {
  const std::vector<nn::PosedImage> images{showing(0.3, 0.6F, 0.2F), showing(0.05, 1, 0, 25),
                                           showing(-0.2, 1.3F, -0.1F)};
  const Visibility seen = find_visibility(plain(), images, exposures_of(images, 0));
  CHECK(share(seen.best, 1, 25, true) == 0);
  CHECK(share(seen.best, 2, 25, true) == 1);  // the next steepest
  CHECK(share(seen.best, 1, 25 + 24, false) == 1);
  CHECK(std::ranges::all_of(seen.views.values(), [](float n) { return n == 3; }));
  const OnOneThread one;
  CHECK(chosen(images) == seen.best);
}

TEST_CASE("the steepest image is believed where it cannot be outvoted") {
  SUBCASE("all show the same") {
    CHECK(share(chosen({showing(0.3, 0.6F, 0.2F), showing(0.05), showing(-0.2)}), 1, 1e3, true) ==
          1);
  }
  SUBCASE("two images") {
    CHECK(share(chosen({showing(0.3), showing(0.05, 1, 0, 25)}), 1, 1e3, true) == 1);
  }
  SUBCASE("another one has the cloud as well") {
    CHECK(share(chosen({showing(0.3, 1, 0, 25), showing(0.05, 1, 0, 25), showing(-0.2)}), 1, 1e3,
                true) == 1);
  }
  SUBCASE("a small thing") {
    CHECK(share(chosen({showing(0.3), showing(0.05, 1, 0, 6), showing(-0.2)}), 1, 1e3, true) == 1);
  }
  SUBCASE("exposures of other images") {
    const std::vector<nn::PosedImage> images{showing(0.3), showing(0.05, 1, 0, 25), showing(-0.2)};
    const Exposures two = exposures_of(images, 0).among({0, 2});
    CHECK(two.images == 2);
    CHECK(share(find_visibility(plain(), images, two).best, 1, 1e3, true) == 1);
  }
}

TEST_CASE("two parts of a surface are judged alike") {
  const std::vector<nn::PosedImage> images{showing(0.3), showing(0.05, 1, 0, 25), showing(-0.2)};
  const Exposures exposures = exposures_of(images, 0);
  const scene::HeightField whole = plain();
  const std::vector<Index> best = find_visibility(whole, images, exposures).best;
  constexpr Index kWest = 101, kPart = kSide - kWest, kRim = 40;  // cells
  const scene::HeightField part{Tensor({kSide, kPart}), whole.x0 + kWest * whole.step, whole.y0,
                                whole.step};
  const std::vector<Index> again = find_visibility(part, images, exposures).best;
  for (Index i = 0; i < kSide; ++i)
    for (Index j = kRim; j < kPart; ++j)
      REQUIRE(again[static_cast<std::size_t>(i * kPart + j)] ==
              best[static_cast<std::size_t>(i * kSide + j + kWest)]);
}

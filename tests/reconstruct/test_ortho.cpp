// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"
#include "satsurf/core/parallel.h"
#include "satsurf/reconstruct/ortho.h"
#include "satsurf/reconstruct/rendered_view.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "tests/affine_scene.h"
#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::reconstruct;
using satsurf::test::AffineCamera;

namespace {

constexpr Index kSide = 40, kFirst = 16, kLast = 24;  // of the plane, and of the box on it: cells
constexpr Index kPixels = 200;

/// A box of 8 x 8 cells, 4 m high, on a plane of 40 x 40 cells of 1 m, with a hole in the plane.
scene::HeightField box_on_plane() {
  scene::HeightField field{Tensor({kSide, kSide}), -20, 20, 1};
  for (Index i = kFirst; i < kLast; ++i)
    for (Index j = kFirst; j < kLast; ++j) field.z[i * kSide + j] = 4;
  field.z[2 * kSide + 3] = std::numeric_limits<float>::quiet_NaN();
  return field;
}

/// A camera whose rays run `west` m to the west for each metre they rise, 0.5 m a pixel.
nn::PosedImage looking(double west) {
  const AffineCamera camera{
      .gsd = 0.5, .slope_x = 2 * west, .centre = static_cast<double>(kPixels - 1) / 2};
  return {Tensor({3, kPixels, kPixels}), Tensor({kPixels, kPixels}, 1.F), camera.local_from_pixel(),
          camera.pixel_from_local()};
}

/// Pixels that say where they are: column, and row + 1000.
Tensor positions() {
  Tensor out({2, kPixels, kPixels});
  for (Index i = 0; i < kPixels * kPixels; ++i) {
    out[i] = static_cast<float>(i % kPixels);
    out[kPixels * kPixels + i] = static_cast<float>(i / kPixels + 1000);
  }
  return out;
}

bool beside_box(Index i) { return i >= kFirst && i < kLast; }

}  // namespace

TEST_CASE("who sees a cell beside a wall, and who sees it best") {
  const scene::HeightField field = box_on_plane();
  // 4 m of wall hide 2 m of ground to the east from the first, 1.2 m to the west from the second
  const std::vector<nn::PosedImage> images{looking(0.5), looking(-0.3)};
  const Visibility seen = find_visibility(field, images);
  for (Index i = 0; i < kSide; ++i)
    for (Index j = 0; j < kSide; ++j) {
      CAPTURE(i);
      CAPTURE(j);
      const Index k = i * kSide + j, best = seen.best[static_cast<std::size_t>(k)];
      if (i == 2 && j == 3) {
        CHECK(std::isnan(seen.views[k]));
        CHECK(best == -1);
        continue;
      }
      const bool hides_first = beside_box(i) && (j == kLast || j == kLast + 1),
                 hides_second = beside_box(i) && j == kFirst - 1;
      CHECK(seen.views[k] == (hides_first || hides_second ? 1 : 2));
      CHECK(best == (hides_second ? 0 : 1));
    }
}

TEST_CASE("an orthophoto takes each cell from the pixel that shows it") {
  const scene::HeightField field = box_on_plane();
  const std::vector<nn::PosedImage> images{looking(0.5), looking(-0.3)};
  const Visibility seen = find_visibility(field, images);
  std::vector<Index> asked;
  const auto pixels = [&](Index i) {
    asked.push_back(i);
    return positions();
  };
  const Tensor ortho = orthophoto(field, images, seen, pixels);
  CHECK(asked == std::vector<Index>{0, 1});
  CHECK(ortho.shape() == Shape{2, kSide, kSide});
  for (Index k = 0; k < kSide * kSide; ++k) {
    const Index best = seen.best[static_cast<std::size_t>(k)];
    if (best < 0) {
      CHECK(std::isnan(ortho[k]));
      continue;
    }
    const auto q = images[static_cast<std::size_t>(best)].pixel_from_local(
        field.x0 + static_cast<double>(k % kSide) + 0.5,
        field.y0 - static_cast<double>(k / kSide) - 0.5, static_cast<double>(field.z[k]));
    REQUIRE(std::abs(static_cast<double>(ortho[k]) - q[0]) < 1e-3);
    REQUIRE(std::abs(static_cast<double>(ortho[kSide * kSide + k]) - 1000 - q[1]) < 1e-3);
  }
  const int before = threads();
  set_threads(1);
  CHECK(find_visibility(field, images).best == seen.best);
  const Tensor again = orthophoto(field, images, seen, pixels);
  set_threads(before);
  for (Index i = 0; i < ortho.count(); ++i)
    REQUIRE((again[i] == ortho[i] || (std::isnan(again[i]) && std::isnan(ortho[i]))));
}

TEST_CASE("a draped view shows each cell where the camera sees it") {
  const scene::HeightField field = box_on_plane();
  Tensor colours({3, kSide, kSide}, 0.25F);
  for (Index i = kFirst; i < kLast; ++i)
    for (Index j = kFirst; j < kLast; ++j) colours[i * kSide + j] = 0.75F;  // the box is red
  for (const double west : {0.0, 0.5}) {
    CAPTURE(west);
    const nn::PosedImage camera = looking(west);
    const Tensor view = draped_view(field, colours, camera);
    REQUIRE(view.shape() == Shape{3, kPixels, kPixels});
    const auto at = [&](double x, double y, double z, Index channel) {
      const auto p = camera.pixel_from_local(x, y, z);
      return view[(channel * kPixels + std::lround(p[1])) * kPixels + std::lround(p[0])];
    };
    CHECK(at(0, 0, 4, 0) == 0.75F);  // the middle of its roof
    CHECK(at(0, 0, 4, 1) == 0.25F);
    CHECK(at(-10, 5, 0, 0) == 0.25F);   // the plane
    CHECK(at(-16.5, 17.5, 0, 0) == 0);  // the hole
    CHECK(at(-30, 0, 0, 0) == 0);       // beside it all
  }
  CHECK_THROWS_AS(draped_view(field, Tensor({3, 4, 4}), looking(0)), ShapeError);
}

TEST_CASE("pixels that are not valid show nothing") {
  const scene::HeightField field = box_on_plane();
  std::vector<nn::PosedImage> images{looking(0.5), looking(-0.3)};
  images[1].valid.fill(0);
  const Visibility seen = find_visibility(field, images);
  CHECK(std::ranges::none_of(seen.best, [](Index i) { return i == 1; }));
  CHECK(seen.views[0] == 1);
  CHECK(seen.views[20 * kSide + kLast] == 0);  // the first does not see it either
  CHECK(seen.best[static_cast<std::size_t>(20 * kSide + kLast)] == -1);
}

TEST_CASE("pixels of another image are refused") {
  const scene::HeightField field = box_on_plane();
  const std::vector<nn::PosedImage> images{looking(0)};
  const Visibility seen = find_visibility(field, images);
  CHECK_THROWS_AS(orthophoto(field, images, seen,
                             [](Index) {
                               return Tensor({1, 4, 4});
                             }),
                  ShapeError);
}

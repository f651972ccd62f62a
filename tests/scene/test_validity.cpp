// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"
#include "satsurf/core/rng.h"
#include "satsurf/scene/image_in_memory.h"
#include "satsurf/scene/validity.h"

#include <algorithm>
#include <cmath>
#include <span>
#include <vector>

#include "tests/made_view.h"
#include "tests/temp_folder.h"
#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::scene;

namespace {

constexpr Index kHeight = 60, kWidth = 80;

Tensor noise(Index channels) {
  Rng rng(3);
  return uniform_tensor<float>({channels, kHeight, kWidth}, rng, 20, 200);
}
Tensor all_valid() { return {{kHeight, kWidth}, 1.0F}; }

/// Gives every pixel that `inside` says one value in all channels.
template <class F>
void fill(Tensor& pixels, float value, F&& inside) {
  for (Index i = 0; i < kHeight * kWidth; ++i)
    if (inside(i % kWidth, i / kWidth))
      for (Index c = 0; c < pixels.dim(0); ++c) pixels[c * kHeight * kWidth + i] = value;
}

template <class F>
bool is_exactly(const Tensor& border, F&& inside) {
  for (Index i = 0; i < kHeight * kWidth; ++i)
    if ((border[i] > 0) != inside(i % kWidth, i / kWidth)) return false;
  return true;
}

}  // namespace

TEST_CASE("a border of one value is found and nothing else") {
  const auto nowhere = [](Index, Index) { return false; };
  const auto strip = [](Index x, Index) { return x < 7; };
  const auto wedges = [](Index x, Index y) { return 2 * x + y < 25 || x - y > kWidth - 20; };
  SUBCASE("none") { CHECK(is_exactly(border_of(noise(3), all_valid()), nowhere)); }
  SUBCASE("a strip of zeros, one pixel wide too") {
    Tensor pixels = noise(1);
    fill(pixels, 0, strip);
    CHECK(is_exactly(border_of(pixels, all_valid()), strip));
    const auto thin = [](Index, Index y) { return y + 1 == kHeight; };
    Tensor other = noise(1);
    fill(other, 0, thin);
    CHECK(is_exactly(border_of(other, all_valid()), thin));
  }
  SUBCASE("wedges of another value, left by a rotation") {
    Tensor pixels = noise(3);
    fill(pixels, 65535, wedges);
    CHECK(is_exactly(border_of(pixels, all_valid()), wedges));
  }
  SUBCASE("two values") {
    Tensor pixels = noise(3);
    const auto right = [](Index x, Index) { return x >= kWidth - 5; };
    fill(pixels, 0, strip);
    fill(pixels, 255, right);
    CHECK(is_exactly(border_of(pixels, all_valid()),
                     [&](Index x, Index y) { return strip(x, y) || right(x, y); }));
  }
  SUBCASE("an inlet in the middle of a long side") {
    Tensor pixels = noise(1);
    const auto inlet = [](Index x, Index y) { return x >= 30 && x < 50 && y < 12; };
    fill(pixels, 0, inlet);
    CHECK(is_exactly(border_of(pixels, all_valid()), inlet));
  }
  SUBCASE("a dark roof inside, one at the rim, and a dark corner of a few pixels stay") {
    Tensor pixels = noise(3);
    fill(pixels, 0, [](Index x, Index y) { return x >= 30 && x < 70 && y >= 20 && y < 40; });
    fill(pixels, 0, [](Index x, Index y) { return x >= 20 && x < 32 && y < 12; });
    fill(pixels, 0, [](Index x, Index y) { return x < 7 && y < 9; });
    CHECK(is_exactly(border_of(pixels, all_valid()), nowhere));
  }
  SUBCASE("zero in one channel alone is a colour") {
    Tensor pixels = noise(3);
    for (Index y = 0; y < kHeight; ++y) std::fill_n(pixels.data() + y * kWidth, 7, 0.0F);
    CHECK(is_exactly(border_of(pixels, all_valid()), nowhere));
  }
  SUBCASE("an image of one value is no border") {
    CHECK(is_exactly(border_of(Tensor({1, kHeight, kWidth}, 90.0F), all_valid()), nowhere));
  }
  SUBCASE("what is not valid is not looked at") {
    Tensor pixels = noise(1), valid = all_valid();
    fill(pixels, 0, strip);
    for (Index y = 0; y < kHeight; ++y) valid[y * kWidth + 3] = 0;
    CHECK(is_exactly(border_of(pixels, valid), [](Index x, Index) { return x < 3; }));
  }
}

TEST_CASE("values that are named say nothing where every channel has one") {
  Tensor pixels = noise(2);
  const auto spot = [](Index x, Index y) { return x == 40 && y == 30; };
  fill(pixels, 17, spot);
  pixels[11 * kWidth + 50] = 17;  // one channel of two
  const Validity named = apply({.nodata = {5, 17}}, pixels, all_valid());
  for (Index i = 0; i < kHeight * kWidth; ++i)
    REQUIRE((named.valid[i] == 0) == spot(i % kWidth, i / kWidth));
  CHECK(named.border == 0);
  fill(pixels, 0, [](Index x, Index) { return x < 8; });
  const Validity found = apply({}, pixels, all_valid());
  CHECK(found.border == doctest::Approx(0.1));
  CHECK(found.valid[30 * kWidth + 7] == 0);
  CHECK(found.valid[30 * kWidth + 8] == 1);
  CHECK(apply({.borders = false}, pixels, all_valid()).valid[30 * kWidth + 7] == 1);
}

TEST_CASE("cameras and heights of images in memory are refused as those of files are") {
  const std::vector<std::uint8_t> values(32 * 32, 7);
  ImageInMemory image{"a", test::view_from("a", 0.3).rpc,        32, 32,
                      1,   std::span<const std::uint8_t>(values)};
  const auto says = [&] {
    return test::error_of<Error>([&] { scene_from_images({image, image}); });
  };
  image.height_range = rpc::HeightRange{-1e300, 1e300};
  CHECK(says().ends_with(" m, expected at most 1000 km either way"));
  image.height_range.reset();
  image.rpc.line_num[2] = std::nan("");
  CHECK(test::error_of<IoError>([&] {
          scene_from_images({image, image});
        }) == "scene_from_images: a: LINE_NUM_COEFF holds nan, expected finite numbers");
}

TEST_CASE("a scene with undeclared borders is the scene with declared ones") {
  rpc::Rpc camera;  // 0.5 m pixels from straight above
  camera.samp_off = camera.samp_scale = kWidth / 2.0;
  camera.line_off = camera.line_scale = kHeight / 2.0;
  camera.lon_off = 20, camera.lat_off = 10, camera.height_off = 20, camera.height_scale = 100;
  camera.lat_scale = camera.line_scale * 0.5 / 110575;
  camera.lon_scale = camera.samp_scale * 0.5 / 109600;
  camera.samp_num[1] = 1, camera.line_num[2] = -1;
  camera.samp_den[0] = camera.line_den[0] = 1;
  rpc::Rpc other = camera;  // from the side: 0.5 px per m
  other.samp_num[3] = 0.5 * camera.height_scale / camera.samp_scale;
  Tensor pixels = noise(1);
  fill(pixels, 0, [](Index x, Index y) { return x + y < 30; });
  std::vector<std::uint16_t> values;
  std::vector<std::uint8_t> declared;
  for (const float v : pixels.values()) {
    values.push_back(static_cast<std::uint16_t>(40 * std::lround(v)));
    declared.push_back(v > 0);
  }
  ImageInMemory image{"a", camera, kWidth, kHeight, 1, std::span<const std::uint16_t>(values)};
  const auto scene_of = [&](std::span<const std::uint8_t> valid, const ValidityRules& rules) {
    ImageInMemory second = image;
    second.rpc = other;
    image.valid = second.valid = valid;
    const rpc::HeightRange range{camera.height_off - 5, camera.height_off + 5};
    ViewRules both;
    both.validity = rules;
    return scene_from_images({image, second}, range, {}, both).scene;
  };
  const Scene found = scene_of({}, {}), told = scene_of(declared, {.borders = false}),
              blind = scene_of({}, {.borders = false});
  CHECK(std::ranges::equal(found.views[0].valid.values(), told.views[0].valid.values()));
  CHECK(std::ranges::equal(found.views[0].rgb.values(), told.views[0].rgb.values()));
  CHECK(!std::ranges::equal(found.views[0].rgb.values(), blind.views[0].rgb.values()));
  CHECK(found.views[0].border > 0.05);
  CHECK(told.views[0].border == 0);
  // ground under the border is not what the view shows
  const auto at = [&](double x, double y) { return camera.localize({x, y}, camera.height_off); };
  CHECK(!found.views[0].shows(at(3, 3)));
  CHECK(found.views[0].shows(at(60, 40)));
  CHECK(blind.views[0].shows(at(3, 3)));
}

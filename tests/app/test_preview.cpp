// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/preview.h"

#include <cmath>
#include <filesystem>
#include <limits>
#include <vector>

#include <OpenImageIO/imageio.h>
#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::app;

namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

float luminance(const Tensor& picture, Index i) {
  const Index P = picture.dim(1) * picture.dim(2);
  return 0.2126f * picture[i] + 0.7152f * picture[P + i] + 0.0722f * picture[2 * P + i];
}

bool grey(const Tensor& picture, Index i) {
  const Index P = picture.dim(1) * picture.dim(2);
  return picture[i] == 0.5f && picture[P + i] == 0.5f && picture[2 * P + i] == 0.5f;
}

}  // namespace

TEST_CASE("pictures: higher is brighter, unknown is grey") {
  const auto z = Tensor::from({1, 5}, {kNan, 100, 101, 102, 103});
  for (const Tensor& picture :
       {height_picture(z), confidence_picture(Tensor::from({1, 5}, {kNan, 0, 0.3f, 0.6f, 1}))}) {
    CHECK(picture.shape() == Shape{3, 1, 5});
    CHECK(grey(picture, 0));
    for (Index i = 1; i < 4; ++i) CHECK(luminance(picture, i) < luminance(picture, i + 1));
  }
  CHECK(grey(height_picture(Tensor({2, 3}, kNan)), 5));
  const Tensor flat = height_picture(Tensor({2, 3}, 7.f));
  CHECK(luminance(flat, 0) == luminance(flat, 5));
}

TEST_CASE("stretched_picture: a dark picture becomes legible, channels keep to one another") {
  Tensor dark({3, 10, 10});
  for (Index i = 0; i < 300; ++i) dark[i] = 0.02F + 0.0005F * static_cast<float>(i);
  dark[7] = kNan;
  const Tensor out = stretched_picture(dark);
  CHECK(std::isnan(out[7]));
  CHECK(out[0] == 0.F);
  CHECK(out[299] == 1.F);
  CHECK(out[150] == doctest::Approx(0.5).epsilon(0.02));
  const Tensor flat = stretched_picture(Tensor({3, 2, 2}, 0.3F));
  CHECK(flat[0] == 0.F);
  CHECK(stretched_picture(Tensor::from({3, 1, 1}, {0.30F, 0.31F, 0.30F}))[1] < 0.5F);  // no noise
  CHECK(std::isnan(stretched_picture(Tensor({3, 1, 1}, kNan))[0]));
}

TEST_CASE("count_colours: those of the picture") {
  const auto colours = count_colours(3);
  REQUIRE(colours.size() == 4);
  const Tensor picture = count_picture(Tensor::from({1, 4}, {0, 1, 2, 3}), 3);
  for (Index n = 0; n < 4; ++n)
    for (std::size_t c = 0; c < 3; ++c)
      CHECK(picture[static_cast<Index>(c) * 4 + n] == colours[static_cast<std::size_t>(n)][c]);
}

TEST_CASE("error_picture: blue is too low, red too high, and it saturates") {
  const Tensor p = error_picture(Tensor::from({1, 4}, {-9, 0, 5, kNan}));
  CHECK(p[8 + 0] > p[0]);
  CHECK(std::abs(p[1] - p[8 + 1]) < 0.02f);
  CHECK(luminance(p, 1) > 0.9f);
  CHECK(p[2] > p[8 + 2]);
  CHECK(grey(p, 3));
  CHECK(p[0] == error_picture(Tensor::from({1, 1}, {-5}))[0]);
}

TEST_CASE("hillshade_picture: a slope to the north-west is lit, one to the south-east is dark") {
  Tensor up({5, 6}), down({5, 6});
  for (Index i = 0; i < 5; ++i)
    for (Index j = 0; j < 6; ++j) {
      up[i * 6 + j] =
          0.4f * static_cast<float>(i + j);  // rises to the south-east: faces north-west
      down[i * 6 + j] = -up[i * 6 + j];
    }
  up[0] = kNan;
  const Tensor lit = hillshade_picture(up, 0.5), dark = hillshade_picture(down, 0.5);
  const Tensor level = hillshade_picture(Tensor({5, 6}, 3.f), 0.5);
  CHECK(lit[14] > level[14]);
  CHECK(dark[14] < level[14]);
  CHECK(level[14] == doctest::Approx(0.08 + 0.92 * std::sin(M_PI / 4)));
  CHECK(grey(lit, 0));
  CHECK(std::isfinite(lit[7]));  // beside the hole
}

TEST_CASE("write_png") {
  const std::filesystem::path folder =
      std::filesystem::temp_directory_path() / "satsurf_test_preview";
  std::filesystem::remove_all(folder);
  std::filesystem::create_directories(folder);
  const std::filesystem::path path = folder / "picture.png";
  SUBCASE("8 bits, clipped, NaN grey") {
    write_png(path, Tensor::from({3, 1, 2}, {0, 2, kNan, 1, 1.f / 255, -1}));
    const auto in = OIIO::ImageInput::open(path.string());
    REQUIRE(in);
    CHECK(in->spec().nchannels == 3);
    std::vector<unsigned char> bytes(6);
    CHECK(in->read_image(0, 0, 0, 3, OIIO::TypeDesc::UINT8, bytes.data()));
    CHECK(bytes == std::vector<unsigned char>{0, 128, 1, 255, 255, 0});
  }
  SUBCASE("other shapes are refused") {
    CHECK_THROWS_WITH_AS(
        write_png(path, Tensor({2, 4, 5})),
        ("write_png: " + path.string() + ": picture has shape [2,4,5], expected [3 H W]").c_str(),
        ShapeError);
    CHECK_FALSE(std::filesystem::exists(path));
  }
  std::filesystem::remove_all(folder);
}

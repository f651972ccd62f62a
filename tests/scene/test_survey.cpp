// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"
#include "satsurf/core/rng.h"
#include "satsurf/rpc/raster.h"
#include "satsurf/scene/simulate/scene.h"
#include "satsurf/scene/survey.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "tests/temp_folder.h"
#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::scene;

namespace {

/// Two made-up images in files, the first with a black border of `border` columns on its left.
struct Files {
  test::TempFolder folder{"survey"};
  std::vector<std::filesystem::path> images;
  rpc::HeightRange range;

  explicit Files(Index pixels, Index border = 0) {
    SimulateConfig config = SimulateConfig();
    config.pixels = pixels, config.views = 2, config.gsd = 0.5, config.water = 0,
    config.kinds = {SceneKind::village};
    const SimulatedScene made = simulate_scene(config, 5, 0);
    range = {made.views[0].rpc.height_off - 60, made.views[0].rpc.height_off + 60};
    for (std::size_t i = 0; i < 2; ++i) {
      images.push_back(folder / ("view_" + std::to_string(i) + ".tif"));
      Tensor values = made.views[i].rgb.clone();
      for (Index k = 0; k < values.count(); ++k)
        values[k] = i == 0 && k % pixels < border ? 0 : std::max(1.f, 255 * values[k]);
      rpc::write_rpc_geotiff(images.back(), values, rpc::PixelType::uint8, made.views[i].rpc);
    }
  }
  Survey survey() const {
    return survey_views(images, {}, range, {}, {.pointing = {.measure = false}});
  }
};

}  // namespace

TEST_CASE("a reduced image keeps every third or fourth pixel, and its camera knows which") {
  const Files files(100);
  const rpc::Image whole = rpc::open_view(files.images[0]);
  for (const Index factor : {1, 3, 4}) {
    CAPTURE(factor);
    const rpc::Image small = rpc::open_reduced(rpc::find_view(files.images[0]), factor);
    REQUIRE(small.info.width == 100 / factor);
    REQUIRE(small.pixels.dim(2) == small.info.width);
    const Index u = 7, v = 11, x = factor * u + factor / 2, y = factor * v + factor / 2;
    CHECK(small.pixels[v * small.info.width + u] == whole.pixels[y * 100 + x]);
    const rpc::Geodetic p = whole.info.rpc->localize(
        {static_cast<double>(x), static_cast<double>(y)}, whole.info.rpc->height_off);
    const rpc::Pixel q = small.info.rpc->project(p);
    CHECK(q.x == doctest::Approx(u).epsilon(1e-4));
    CHECK(q.y == doctest::Approx(v).epsilon(1e-4));
  }
  CHECK_THROWS_AS(rpc::open_reduced(rpc::find_view(files.images[0]), 101), IoError);
}

TEST_CASE("a window is the image's own pixels under the image's own camera") {
  const Files files(200);
  const Survey survey = files.survey();
  CHECK(survey.factor == 1);
  const rpc::LocalFrame& frame = survey.user.scene.frame;
  const Ground ground{-15, -10, 20, 15};
  const Polygon box = corners_of(ground);
  const WindowedScene part = read_windows(survey, box, {-5, 10});
  REQUIRE(part.views == std::vector<std::size_t>{0, 1});
  for (std::size_t i = 0; i < 2; ++i) {
    const View& whole = survey.user.scene.views[i];
    const View& view = part.scene.views[i];
    CHECK(view.width() < whole.width());
    const auto window = window_of(survey.views[i], frame, box, {-5, 10});
    REQUIRE(window);
    CHECK(view.width() == window->width);
    const Index at = (window->y0 + 3) * whole.width() + window->x0 + 5;
    CHECK(view.rgb[3 * view.width() + 5] == whole.rgb[at]);
    CHECK(part.values[i][3 * view.width() + 5] == doctest::Approx(255 * whole.rgb[at]));
    const rpc::Geodetic p = frame.geodetic_from_local({3, 4, 2});
    CHECK(view.rpc.project(p).x ==
          doctest::Approx(whole.rpc.project(p).x - static_cast<double>(window->x0)));
    for (const double x : {ground.x0, ground.x1})
      for (const double z : {-5.0, 10.0})
        CHECK(view.contains(frame.geodetic_from_local({x, ground.y1 - 0.01, z})));
  }
  CHECK(read_windows(survey, corners_of({5000, 5000, 5010, 5010}), {0, 10}).views.empty());
}

TEST_CASE("the border of an image is left out of its windows too") {
  const Files files(200, 30);
  const Survey survey = files.survey();
  REQUIRE(survey.user.scene.views[0].border == doctest::Approx(0.15));
  REQUIRE(survey.views[0].border_values.size() == 1);
  CHECK(survey.views[1].border_values.empty());
  const WindowedScene part = read_windows(survey, corners_of({-60, -60, 60, 60}), {-5, 5});
  REQUIRE(part.views.size() == 2);
  const View& view = part.scene.views[0];
  const auto window =
      window_of(survey.views[0], survey.user.scene.frame, corners_of({-60, -60, 60, 60}), {-5, 5});
  REQUIRE(window);
  Index wrong = 0;
  for (Index i = 0; i < view.valid.count(); ++i)
    wrong += (view.valid[i] > 0) != (window->x0 + i % view.width() >= 30);
  CHECK(wrong == 0);
}

TEST_CASE("a terrain that the ties of large images contradict says nothing") {
  // 700 px made three times as large: more than a copy holds.
  constexpr Index kTimes = 3, kSmall = 700, kLarge = kTimes * kSmall;
  SimulateConfig config = SimulateConfig();
  config.pixels = kSmall, config.views = 2, config.gsd = 0.5, config.water = 0;
  config.kinds = {SceneKind::village}, config.same_pass = 1, config.panchromatic = 1;
  const SimulatedScene made = simulate_scene(config, 5, 0);
  const test::TempFolder folder("survey_terrain");
  std::vector<std::filesystem::path> images;
  for (std::size_t i = 0; i < 2; ++i) {
    auto values = Tensor::uninitialised({1, kLarge, kLarge});
    for (Index y = 0; y < kLarge; ++y)
      for (Index x = 0; x < kLarge; ++x) {
        const auto at = [](Index k) {
          return std::clamp((static_cast<float>(k) + 0.5f) / kTimes - 0.5f, 0.f,
                            static_cast<float>(kSmall) - 1.001f);
        };
        const float u = at(x), v = at(y);
        const auto j = static_cast<Index>(u), k = static_cast<Index>(v);
        const float a = u - static_cast<float>(j), b = v - static_cast<float>(k);
        const float* p = made.views[i].rgb.data() + k * kSmall + j;
        values[y * kLarge + x] = 255 * ((1 - b) * ((1 - a) * p[0] + a * p[1]) +
                                        b * ((1 - a) * p[kSmall] + a * p[kSmall + 1]));
      }
    rpc::Rpc camera = made.views[i].rpc;
    camera.samp_off = kTimes * (camera.samp_off + 0.5) - 0.5, camera.samp_scale *= kTimes;
    camera.line_off = kTimes * (camera.line_off + 0.5) - 0.5, camera.line_scale *= kTimes;
    images.push_back(folder / ("view_" + std::to_string(i) + ".tif"));
    rpc::write_rpc_geotiff(images.back(), values, rpc::PixelType::uint8, camera);
  }
  // and the first of them once more, which is no view of its own
  images.push_back(folder / "view_2.tif");
  std::filesystem::copy_file(images[0], images[2]);
  const double ground = made.frame.h0 + static_cast<double>(made.dsm.z[0]);
  const auto surveyed = [&](double height) {
    rpc::write_geo_raster(
        folder / "dem.tif", Tensor({80, 80}, static_cast<float>(height)),
        {made.frame.zone.epsg(), made.frame.easting0 - 400, made.frame.northing0 + 400, 10},
        rpc::ellipsoidal_height("Terrain"));
    ViewRules rules;
    rules.terrain = std::make_shared<rpc::Terrain>(folder / "dem.tif");
    return survey_views(images, {}, {}, {}, rules);
  };
  const Survey right = surveyed(ground);
  REQUIRE(right.factor == 2);
  REQUIRE(right.user.left_out.size() == 1);
  CHECK(right.user.range.source == "from the terrain");
  CHECK(right.user.range.trouble.empty());
  REQUIRE(right.user.pointing);
  REQUIRE(right.user.pointing->heights);

  const Survey wrong = surveyed(ground + 40);  // its range begins above the ground
  CHECK(wrong.user.range.source == "found by comparing the images");
  CHECK(wrong.user.range.trouble.find("the images see it from") != std::string::npos);
  CHECK(wrong.user.range.height_range.low < ground + 5);
  CHECK(wrong.user.pointing.has_value());
  CHECK(wrong.views.size() == 2);
  REQUIRE(wrong.user.left_out.size() == 1);
  CHECK(wrong.user.left_out[0].label == right.user.left_out[0].label);
  CHECK(wrong.user.left_out[0].why == right.user.left_out[0].why);
}

TEST_CASE("an image that is named twice is looked at once") {
  const Files files(200);
  const std::filesystem::path &a = files.images[0], &b = files.images[1];
  for (const std::vector<std::filesystem::path>& named :
       {std::vector{a, a, b}, {a, b, a}, {b, a, a}}) {
    const Survey survey =
        survey_views(named, {}, files.range, {}, {.pointing = {.measure = false}});
    REQUIRE(survey.user.scene.views.size() == 2);
    REQUIRE(survey.views.size() == 2);
    for (std::size_t i = 0; i < 2; ++i) {
      CHECK(survey.views[i].source.file == survey.user.scene.views[i].file);
      CHECK(survey.views[i].rpc == survey.user.scene.views[i].rpc);
    }
    REQUIRE(survey.user.left_out.size() == 1);
    CHECK(survey.user.left_out[0].label == a.string());
    CHECK(survey.user.left_out[0].why == "seen from the same direction as " + a.string());
    CHECK(read_windows(survey, corners_of({-15, -10, 20, 15}), {-5, 10}).views ==
          std::vector<std::size_t>{0, 1});
  }
}

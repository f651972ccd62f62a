// SPDX-License-Identifier: Apache-2.0
#include "satsurf/train/dataset.h"
#include "satsurf/train/reconstruct.h"
#include "satsurf/train/simulate/scene.h"

#include <cmath>
#include <fstream>

#include "tests/temp_folder.h"
#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::test;
using namespace satsurf::train;

namespace {

SimulateConfig small_scene() {
  SimulateConfig c = SimulateConfig();
  c.pixels = 96;
  c.views = 4;
  c.gsd = 0.5;
  c.kinds = {"village"};
  return c;
}

}  // namespace

TEST_CASE("a simulated scene comes back from its files") {
  const TempFolder folder("dataset-1");
  const SimulatedScene made = simulate_scene(small_scene(), 3, 0);
  write_scene(made, folder.path(), "SIM_001");
  CHECK(list_scenes(folder.path()) == std::vector<std::string>{"SIM_001"});
  const Scene scene = load_scene(folder.path(), "SIM_001");
  REQUIRE(scene.views.size() == 4);
  REQUIRE(scene.truth.has_value());
  CHECK(scene.frame.zone == made.frame.zone);
  for (std::size_t i = 0; i < 4; ++i) {
    const SceneView& view = scene.views[i];
    for (Index p = 0; p < view.rgb.count(); ++p)
      REQUIRE(std::abs(view.rgb[p] - made.views[i].rgb[p]) < 1e-6f);
    const rpc::Geodetic g = made.frame.geodetic_from_local({3, -4, 1});
    const rpc::Pixel a = view.rpc.project(g), b = made.views[i].rpc.project(g);
    CHECK(std::hypot(a.x - b.x, a.y - b.y) < 1e-6);
  }
  // The same ground under both frames: absolute position and height of the truth's first cell.
  const double east = scene.truth->x0 + scene.frame.easting0,
               made_east = made.dsm.x0 + made.frame.easting0;
  CHECK(east == doctest::Approx(made_east).epsilon(1e-12));
  CHECK(static_cast<double>(scene.truth->z[0]) + scene.frame.h0 ==
        doctest::Approx(static_cast<double>(made.dsm.z[0]) + made.frame.h0).epsilon(1e-5));
}

TEST_CASE("a crop's cameras, pixels and true heights agree") {
  const TempFolder folder("dataset-2");
  write_scene(simulate_scene(small_scene(), 5, 0), folder.path(), "SIM_001");
  const Scene scene = load_scene(folder.path(), "SIM_001");
  const Crop crop =
      make_crop(scene, {0, 2}, Index{3}, 0, 0, 0, 64, scene.z_low, scene.z_high, true);
  REQUIRE(crop.input.sources.size() == 2);
  REQUIRE(crop.target.has_value());
  REQUIRE(crop.source_truth.size() == 3);
  for (std::size_t s = 0; s < 3; ++s)
    CHECK(crop.source_truth[s][1].shape() == Shape{Index{16} << s, Index{16} << s});
  const nn::View& a = crop.input.sources[0];
  for (const Index p : {Index{20 * 64 + 20}, Index{40 * 64 + 17}}) {
    const double x = static_cast<double>(p % 64), y = static_cast<double>(p / 64);
    const double z = static_cast<double>(crop.source_truth[2][0][p]);
    REQUIRE(std::isfinite(z));
    const auto ground = a.local_from_pixel(x, y, z);
    const auto back = a.pixel_from_local(ground[0], ground[1], z);
    CHECK(std::hypot(back[0] - x, back[1] - y) < 2e-3);
    const auto other = crop.input.transfer[0][1](x, y, z);
    const auto seen = crop.input.sources[1].pixel_from_local(ground[0], ground[1], z);
    CHECK(std::hypot(other[0] - seen[0], other[1] - seen[1]) < 5e-3);
    // the truth under that point is the height the ray stopped at
    const HeightField& t = *scene.truth;
    const Index j = static_cast<Index>((ground[0] - t.x0) / t.step),
                i = static_cast<Index>((t.y0 - ground[1]) / t.step);
    float nearest = INFINITY;
    for (Index di = -1; di <= 1; ++di)
      for (Index dj = -1; dj <= 1; ++dj)
        nearest = std::min(nearest,
                           std::abs(t.z[(i + di) * t.z.dim(1) + j + dj] - static_cast<float>(z)));
    CHECK(nearest < 0.5f);
  }
}

TEST_CASE("pixels outside an image are invalid") {
  const TempFolder folder("dataset-3");
  write_scene(simulate_scene(small_scene(), 5, 0), folder.path(), "SIM_001");
  const Scene scene = load_scene(folder.path(), "SIM_001");
  const Crop crop =
      make_crop(scene, {0, 1}, std::nullopt, 0, 0, 0, 128, scene.z_low, scene.z_high, false);
  const Tensor& valid = crop.input.sources[0].valid;
  CHECK(valid[0] == 0);
  CHECK(valid[64 * 128 + 64] == 1);
  Index seen = 0;
  for (const float v : valid.values()) seen += v > 0 ? 1 : 0;
  CHECK(seen > 80 * 80);
  CHECK(seen <= 96 * 96);
  CHECK_FALSE(crop.target.has_value());
  CHECK(crop.source_truth.empty());
}

TEST_CASE("folders that are no data sets are refused") {
  const TempFolder folder("dataset-4");
  CHECK_THROWS_WITH_AS(
      list_scenes(folder.path() / "nowhere"),
      ((folder.path() / "nowhere").string() + ": no such folder, expected a data set").c_str(),
      IoError);
  CHECK_THROWS_AS(list_scenes(folder.path()), IoError);
  std::filesystem::create_directories(folder.path() / "Track3-RGB");
  CHECK_THROWS_AS(list_scenes(folder.path()), IoError);
}

TEST_CASE("the height range of a scene is found by comparing its images") {
  SimulateConfig config = small_scene();
  config.pixels = 192;
  config.kinds = {"rural"};
  const SimulatedScene made = simulate_scene(config, 11, 0);
  Scene scene;
  scene.frame = made.frame;
  for (const SimulatedView& v : made.views)
    scene.views.push_back({"v", v.rgb, Tensor({192, 192}, 1.f), v.rpc, 0, 0, ""});
  const double low = made.h_min - made.frame.h0, high = made.h_max - made.frame.h0;
  const auto [found_low, found_high] = find_height_range(scene, low - 300, high + 300);
  CHECK(found_low <
        low + 8);  // percentiles may miss the deepest corner, the margin covers most of it
  CHECK(found_high > low);
  CHECK(found_high - found_low < high - low + 80);
  CHECK_THROWS_AS(find_height_range(scene, high + 400, high + 700), Error);
}

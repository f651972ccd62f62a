// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"
#include "satsurf/rpc/raster.h"
#include "satsurf/scene/classes.h"
#include "satsurf/scene/crop.h"
#include "satsurf/scene/dataset.h"
#include "satsurf/scene/simulate/scene.h"

#include <array>
#include <cmath>
#include <fstream>
#include <memory>
#include <string>

#include "tests/made_view.h"
#include "tests/temp_folder.h"
#include <doctest/doctest.h>
#include <gdal_priv.h>
#include <nlohmann/json.hpp>
#include <ogr_spatialref.h>

using namespace satsurf;
using namespace satsurf::test;
using namespace satsurf::scene;

namespace {

SimulateConfig small_scene() {
  SimulateConfig c = SimulateConfig();
  c.pixels = 96;
  c.views = 4;
  c.gsd = 0.5;
  c.kinds = {scene::SceneKind::village};
  return c;
}

/// The JSON file of a view as Sat-NeRF's tools write it.
std::string satnerf_json(const View& v, const std::string& image, double low, double high) {
  const rpc::Rpc& r = v.rpc;
  const nlohmann::json camera{
      {"row_offset", r.line_off},    {"col_offset", r.samp_off},   {"lat_offset", r.lat_off},
      {"lon_offset", r.lon_off},     {"alt_offset", r.height_off}, {"row_scale", r.line_scale},
      {"col_scale", r.samp_scale},   {"lat_scale", r.lat_scale},   {"lon_scale", r.lon_scale},
      {"alt_scale", r.height_scale}, {"row_num", r.line_num},      {"row_den", r.line_den},
      {"col_num", r.samp_num},       {"col_den", r.samp_den}};
  return nlohmann::json{{"img", image},
                        {"width", v.rgb.dim(2)},
                        {"height", v.rgb.dim(1)},
                        {"sun_elevation", "+" + std::to_string(v.sun_elevation_deg)},
                        {"sun_azimuth", std::to_string(v.sun_azimuth_deg)},
                        {"acquisition_date", v.date},
                        {"min_alt", low},
                        {"max_alt", high},
                        {"rpc", camera}}
      .dump();
}

/// Writes `scene` as `folder`/train.txt, test.txt (the last view) and one JSON file per view.
void write_satnerf(const Scene& scene, const std::filesystem::path& folder) {
  std::filesystem::create_directories(folder);
  std::string train;
  for (const View& v : scene.views) {
    write_bytes(folder / (v.name + ".json"), satnerf_json(v, v.name + ".tif", -20, 60));
    if (&v != &scene.views.back()) train += v.name + ".json\n";
  }
  write_bytes(folder / "train.txt", train);
  write_bytes(folder / "test.txt", scene.views.back().name + ".json\r\n\n");
}

bool same_values(const Tensor& a, const Tensor& b) {
  return a.shape() == b.shape() &&
         std::equal(a.values().begin(), a.values().end(), b.values().begin(),
                    [](float x, float y) { return x == y || (std::isnan(x) && std::isnan(y)); });
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
    const View& view = scene.views[i];
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
  const Crop crop = make_crop(scene, {.sources = {0, 2},
                                      .target = 3,
                                      .size = {64, 64},
                                      .z_range = scene.z_range,
                                      .with_truth = true});
  REQUIRE(crop.input.sources.size() == 2);
  REQUIRE(crop.target.has_value());
  REQUIRE(crop.source_truth.size() == 3);
  for (std::size_t s = 0; s < 3; ++s)
    CHECK(crop.source_truth[s][1].shape() == Shape{Index{16} << s, Index{16} << s});
  const nn::PosedImage& a = crop.input.sources[0];
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

TEST_CASE("the window around some ground holds what every image shows of it, and hardly more") {
  const TempFolder folder("dataset-3");
  write_scene(simulate_scene(small_scene(), 5, 0), folder.path(), "SIM_001");
  const Scene scene = load_scene(folder.path(), "SIM_001");
  const View& any = scene.views[0];
  const auto ground = [](double x, double y, double w, double h) {
    return Ground{x - w, y - h, x + w, y + h};
  };
  const auto middle = scene.frame.local_from_geodetic(any.rpc.localize(
      {0.5 * static_cast<double>(any.width()), 0.5 * static_cast<double>(any.height())},
      scene.frame.h0 + scene.z_range.middle()));
  CHECK(largest_image(scene, scene.frame.geodetic_from_local({middle[0], middle[1], 0})) ==
        WindowSize{any.height(), any.width()});
  const auto around = [&](double w, double h) {
    return window_around(scene, ground(middle[0], middle[1], w, h), 5000, 1);
  };
  const WindowSize wide = around(12, 3), high = around(3, 12), all = around(1e4, 1e4);
  CHECK(wide.width > wide.height);
  CHECK(high.height > high.width);
  // what lies outside of the images does not count
  CHECK(all.height <= any.height() + 40);
  CHECK(all.width <= any.width() + 40);
  CHECK(all.width >= wide.width);
  CHECK(window_around(scene, ground(middle[0] + 5e3, middle[1], 10, 10), 5000, 8) ==
        WindowSize{8, 8});
  const WindowSize less = window_around(scene, ground(middle[0], middle[1], 12, 3), 9, 4);
  CHECK(less.width == 12);  // at most 9, rounded up
  CHECK(less.height <= 12);
  // corners at any height fall into the crop of that size
  const Crop crop = make_crop(scene, {.sources = {0, 1},
                                      .centre = {middle[0], middle[1], scene.z_range.middle()},
                                      .size = wide,
                                      .z_range = scene.z_range});
  const Ground g = ground(middle[0], middle[1], 12, 3);
  for (const nn::PosedImage& view : crop.input.sources) {
    CHECK(view.rgb.shape() == Shape{3, wide.height, wide.width});
    for (const double x : {g.x0, g.x1})
      for (const double y : {g.y0, g.y1})
        for (const double z : {scene.z_range.low, scene.z_range.high}) {
          const auto p = view.pixel_from_local(x, y, z);
          CHECK(p[0] > 0);
          CHECK(p[1] > 0);
          CHECK(p[0] < static_cast<double>(wide.width - 1));
          CHECK(p[1] < static_cast<double>(wide.height - 1));
        }
  }
}

TEST_CASE("the least window is around what the views show of a ground") {
  const TempFolder folder("dataset-6");
  write_scene(simulate_scene(small_scene(), 5, 0), folder.path(), "SIM_001");
  const Scene scene = load_scene(folder.path(), "SIM_001");
  const View& any = scene.views[0];
  const auto middle = scene.frame.local_from_geodetic(any.rpc.localize(
      {0.5 * static_cast<double>(any.width()), 0.5 * static_cast<double>(any.height())},
      scene.frame.h0 + scene.z_range.middle()));
  const auto window_of = [&](double width) {
    const Polygon ground =
        corners_of({middle[0] - 4, middle[1] - 8, middle[0] - 4 + width, middle[1] + 8});
    const GroundWindow window = least_window(scene, ground, 5000, 1);
    CHECK(window.size == window_around(scene, ground, window.middle, 5000, 1));
    return window;
  };
  const GroundWindow inside = window_of(8), beyond = window_of(2000);
  CHECK(inside.middle[0] == doctest::Approx(middle[0]).epsilon(0.01));
  CHECK(beyond.middle[0] > middle[0] + 2);
  CHECK(beyond.size.width < any.width());  // the middle of the ground itself is in no image
  const Ground ground{middle[0] - 4, middle[1] - 8, middle[0] + 1996, middle[1] + 8};
  CHECK(beyond.size.width < window_around(scene, ground, 5000, 1).width / 4);
}

TEST_CASE("pixels outside an image are invalid") {
  const TempFolder folder("dataset-3");
  write_scene(simulate_scene(small_scene(), 5, 0), folder.path(), "SIM_001");
  const Scene scene = load_scene(folder.path(), "SIM_001");
  const Crop crop =
      make_crop(scene, {.sources = {0, 1}, .size = {128, 128}, .z_range = scene.z_range});
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

TEST_CASE("heights that no other image shows, and those of water, are no true heights to find") {
  const TempFolder folder("dataset-7");
  write_scene(simulate_scene(small_scene(), 5, 0), folder.path(), "SIM_001");
  Scene scene = load_scene(folder.path(), "SIM_001");
  REQUIRE(!scene.classes.empty());
  const HeightField& truth = *scene.truth;
  for (Index i = 0; i < scene.classes.count(); ++i)  // the north-west of everything
    if (i % truth.z.dim(1) < truth.z.dim(1) / 2 && i / truth.z.dim(1) < truth.z.dim(0) / 2)
      scene.classes[i] = kWaterClass;
  const auto cut = [&] {
    return make_crop(
        scene,
        {.sources = {0, 1, 2}, .size = {64, 96}, .z_range = scene.z_range, .with_truth = true});
  };
  const Crop before = cut();
  Crop after = cut();
  forget_untold_truth(after, scene);
  Index wet = 0, alone = 0, left = 0, unlike = 0;
  for (std::size_t s = 0; s < 3; ++s)
    for (std::size_t i = 0; i < 3; ++i) {
      const nn::PosedImage& image = before.input.sources[i];
      const Tensor &was = before.source_truth[s][i], &is = after.source_truth[s][i];
      const double stride = 96.0 / static_cast<double>(was.dim(1));
      for (Index p = 0; p < was.count(); ++p) {
        if (!std::isfinite(was[p])) continue;
        const auto z = static_cast<double>(was[p]);
        const auto at =
            image.local_from_pixel((static_cast<double>(p % was.dim(1)) + 0.5) * stride - 0.5,
                                   (static_cast<double>(p / was.dim(1)) + 0.5) * stride - 0.5, z);
        const bool in_water =
            at[0] < truth.x0 + truth.step * static_cast<double>(truth.z.dim(1) / 2) &&
            at[1] > truth.y0 - truth.step * static_cast<double>(truth.z.dim(0) / 2);
        bool shown = false;
        for (std::size_t j = 0; j < 3; ++j) {
          if (j == i) continue;
          const nn::PosedImage& other = before.input.sources[j];
          const auto q = other.pixel_from_local(at[0], at[1], z);
          const auto x = std::lround(q[0]), y = std::lround(q[1]);
          shown |= x >= 0 && y >= 0 && x < 96 && y < 64 && other.valid[y * 96 + x] > 0;
        }
        (in_water ? wet : shown ? left : alone) += 1;
        unlike += std::isfinite(is[p]) != (shown && !in_water);
      }
    }
  CHECK(wet > 100);
  CHECK(alone > 100);
  CHECK(left > 1000);
  CHECK(unlike <
        (wet + alone + left) / 200);  // cameras are fitted: a pixel at a rim may fall either way
}

TEST_CASE("a camera that sees the middle of a crop nowhere near its image is named") {
  Scene scene;
  scene.views = {test::view_from("a", -0.3), test::view_from("b", 0.3)};
  scene.frame.zone = rpc::utm_zone_of(21, 10);
  const auto middle = rpc::utm_from_geodetic(scene.frame.zone, 21, 10);
  scene.frame.easting0 = middle[0], scene.frame.northing0 = middle[1];
  const auto crop = [&] {
    return make_crop(scene, {.sources = {0, 1}, .size = {32, 32}, .z_range = {0, 40}});
  };
  CHECK(crop().input.sources.size() == 2);
  for (const double shift : {1e300, double{INFINITY}, std::nan("")}) {
    scene.views[1].rpc.samp_num[0] = shift;  // its pixels are no whole numbers
    CHECK(test::error_of<Error>(crop).starts_with("make_crop: b sees the middle at ("));
  }
}

TEST_CASE("a data set with a camera that sees nothing is refused by the name of its image") {
  const TempFolder folder("dataset-4");
  const auto image = folder / "Track3-RGB/S_001_RGB.tif";
  std::filesystem::create_directories(image.parent_path());
  rpc::Rpc camera = test::view_from("a", 0.3).rpc;
  camera.samp_num = {1};  // the same column everywhere
  rpc::write_rpc_geotiff(image, Tensor({1, 32, 32}, 9.F), rpc::PixelType::uint8, camera);
  CHECK(test::error_of<IoError>([&] {
          load_scene(folder.path(), "S");
        }).starts_with(image.string() + ": its camera sees no ground; Rpc::localize: residual "));
}

TEST_CASE("a Sat-NeRF folder holds the same scene as Track3 files") {
  const TempFolder folder("dataset-5");
  write_scene(simulate_scene(small_scene(), 3, 0), folder / "track", "SIM_001");
  const Scene known = load_scene(folder / "track", "SIM_001");
  const auto compare = [&](const std::filesystem::path& data) {
    CAPTURE(data.string());
    REQUIRE(list_scenes(data) == std::vector<std::string>{"SIM_001"});
    const Scene scene = load_scene(data, "SIM_001");
    CHECK(scene.frame == known.frame);
    CHECK(scene.z_range == known.z_range);
    REQUIRE(scene.truth.has_value());
    CHECK(same_values(scene.truth->z, known.truth->z));
    CHECK(scene.truth->x0 == known.truth->x0);
    CHECK(scene.truth->step == known.truth->step);
    CHECK(same_values(scene.classes, known.classes));
    REQUIRE(scene.views.size() == known.views.size());
    for (std::size_t i = 0; i < known.views.size(); ++i) {
      CHECK(scene.views[i].name == known.views[i].name);
      CHECK(scene.views[i].date == known.views[i].date);
      CHECK(scene.views[i].sun_azimuth_deg ==
            doctest::Approx(known.views[i].sun_azimuth_deg).epsilon(1e-6));
      CHECK(same_values(scene.views[i].rgb, known.views[i].rgb));
      CHECK(same_values(scene.views[i].valid, known.views[i].valid));
      const rpc::Geodetic g = known.frame.geodetic_from_local({3, -4, 1});
      const rpc::Pixel a = scene.views[i].rpc.project(g), b = known.views[i].rpc.project(g);
      CHECK(std::hypot(a.x - b.x, a.y - b.y) < 1e-9);
    }
  };
  namespace fs = std::filesystem;
  SUBCASE("images beside the JSON files, truth in truth/, the scene or its parent named") {
    const fs::path scene = folder / "set" / "SIM_001";
    write_satnerf(known, scene);
    for (const auto& f : fs::directory_iterator(folder / "track" / "Track3-RGB"))
      fs::copy(f, scene);
    fs::copy(folder / "track" / "Track3-Truth", folder / "set" / "truth");
    compare(scene);
    compare(scene / "");
    compare(folder / "set");
  }
  SUBCASE("images and truth as in Sat-NeRF's own archive") {
    const fs::path scene = folder / "root_dir" / "crops_rpcs_ba_v2" / "SIM_001";
    write_satnerf(known, scene);
    fs::create_directories(folder / "DFC2019" / "Track3-RGB-crops");
    fs::copy(folder / "track" / "Track3-RGB", folder / "DFC2019" / "Track3-RGB-crops" / "SIM_001");
    fs::copy(folder / "track" / "Track3-Truth", folder / "DFC2019" / "Track3-Truth");
    compare(scene);
    compare(folder / "root_dir" / "crops_rpcs_ba_v2");
  }
  SUBCASE("the JSON's camera replaces the image's, and its heights serve without truth") {
    const fs::path scene = folder / "SIM_001";
    Scene moved = known;
    for (View& v : moved.views) v.rpc = v.rpc.cropped(2, 0);
    write_satnerf(moved, scene);
    fs::copy(folder / "track" / "Track3-RGB", scene / "images");
    const Scene read = load_scene(scene, "SIM_001");
    CHECK_FALSE(read.truth.has_value());
    CHECK(read.classes.empty());
    CHECK(read.frame.heights_from_z(read.z_range) == rpc::HeightRange{-20, 60});
    const rpc::Geodetic g = known.frame.geodetic_from_local({3, -4, 1});
    CHECK(read.views[0].rpc.project(g).x ==
          doctest::Approx(known.views[0].rpc.project(g).x - 2).epsilon(1e-9));
  }
}

TEST_CASE("the folders of EOGS hold the same scene, with the cameras of their JSON files") {
  namespace fs = std::filesystem;
  const TempFolder folder("dataset-eogs");
  write_scene(simulate_scene(small_scene(), 3, 0), folder / "track", "SIM_001");
  const Scene known = load_scene(folder / "track", "SIM_001");
  const fs::path data = folder / "eogs";
  for (const char* kind : {"images", "truth", "rpcs"}) fs::create_directories(data / kind);
  fs::rename(folder / "track" / "Track3-RGB", data / "images" / "SIM_001");
  fs::rename(folder / "track" / "Track3-Truth", data / "truth" / "SIM_001");
  fs::create_directories(data / "rpcs" / "SIM_001");
  fs::create_directories(data / "images" / "SIM_002");
  write_bytes(data / "images" / "notes.txt", "no scene");
  for (std::size_t i = 0; i + 1 < known.views.size(); ++i) {  // the last has its own alone
    View moved = known.views[i];
    moved.rpc = moved.rpc.cropped(2, 0);
    write_bytes(data / "rpcs" / "SIM_001" / (moved.name + ".json"),
                satnerf_json(moved, moved.name + ".tif", -20, 60));
  }
  CHECK(list_scenes(data) == std::vector<std::string>{"SIM_001", "SIM_002"});
  const Scene scene = load_scene(data, "SIM_001");
  CHECK(scene.truth_file == data / "truth" / "SIM_001" / "SIM_001_DSM.tif");
  REQUIRE(scene.truth.has_value());
  CHECK(same_values(scene.truth->z, known.truth->z));
  CHECK(same_values(scene.classes, known.classes));
  CHECK(scene.frame == known.frame);
  CHECK(scene.z_range == known.z_range);
  REQUIRE(scene.views.size() == known.views.size());
  const rpc::Geodetic g = known.frame.geodetic_from_local({3, -4, 1});
  for (std::size_t i = 0; i < known.views.size(); ++i) {
    CAPTURE(i);
    CHECK(scene.views[i].name == known.views[i].name);
    CHECK(same_values(scene.views[i].rgb, known.views[i].rgb));
    const rpc::Pixel a = scene.views[i].rpc.project(g), b = known.views[i].rpc.project(g);
    const double shift = i + 1 < known.views.size() ? 2 : 0;
    CHECK(std::hypot(a.x + shift - b.x, a.y - b.y) < 1e-9);
  }
}

TEST_CASE("broken Sat-NeRF folders are refused by name") {
  const TempFolder folder("dataset-6");
  write_scene(simulate_scene(small_scene(), 3, 0), folder / "track", "SIM_001");
  const Scene known = load_scene(folder / "track", "SIM_001");
  const std::filesystem::path scene = folder / "SIM_001";
  write_satnerf(known, scene);
  const std::string where = scene.string();
  CHECK(error_of<IoError>([&] { load_scene(scene, "SIM_001"); })
            .starts_with(where +
                         "/SIM_001_001_RGB.json: its image \"SIM_001_001_RGB.tif\" was "
                         "not found, looked in " +
                         where + ", " + folder.path().string() + ", "));
  write_bytes(scene / "train.txt", "SIM_001_001_RGB.json\n\n lost.json\n");
  const std::string lost =
      where + "/train.txt: line 3 names lost.json, but there is no " + where + "/lost.json";
  CHECK(error_of<IoError>([&] { load_scene(scene, "SIM_001"); }) == lost);
  CHECK(error_of<IoError>([&] { list_scenes(scene); }) == lost);
  write_bytes(scene / "train.txt", "\n");
  CHECK(error_of<IoError>([&] { list_scenes(scene); }) ==
        where + "/train.txt: names no view, expected one JSON file a line");
}

TEST_CASE("truth that does not fit together is refused by name") {
  const TempFolder folder("dataset-7");
  write_scene(simulate_scene(small_scene(), 3, 0), folder.path(), "SIM_001");
  const auto truth = folder / "Track3-Truth";
  const std::string dsm_file = (truth / "SIM_001_DSM.tif").string(),
                    classes_file = (truth / "SIM_001_CLS.tif").string();
  const Scene known = load_scene(folder.path(), "SIM_001");
  const Index H = known.classes.dim(0), W = known.classes.dim(1);
  const rpc::GeoRaster dsm = rpc::read_geo_raster(dsm_file, known.frame.zone);
  const auto refusal = [&] {
    return error_of<IoError>([&] { load_scene(folder.path(), "SIM_001"); });
  };
  const auto cells = [](Index h, Index w) {
    return std::to_string(w) + " x " + std::to_string(h) + " cells of ";
  };

  rpc::write_geo_raster(classes_file, Tensor({H - 1, W}), dsm.grid);
  const std::string smaller = refusal();
  CAPTURE(smaller);
  CHECK(smaller.starts_with(classes_file + ": " + cells(H - 1, W)));
  CHECK(smaller.find(", expected the grid of " + dsm_file + ", " + cells(H, W)) !=
        std::string::npos);
  for (const auto& [east, north, scale] : {std::array<double, 3>{1, 0, 1}, {0, -1, 1}, {0, 0, 2}}) {
    CAPTURE(east);
    CAPTURE(north);
    rpc::GeoGrid moved = dsm.grid;
    moved.x0 += east * moved.step, moved.y0 += north * moved.step, moved.step *= scale;
    rpc::write_geo_raster(classes_file, Tensor({H, W}), moved);
    CHECK(refusal().starts_with(classes_file + ": " + cells(H, W)));
  }
  rpc::GeoGrid point = dsm.grid;  // half a cell is the other convention
  point.x0 += 0.5 * point.step, point.y0 -= 0.5 * point.step;
  rpc::write_geo_raster(classes_file, known.classes, point);
  CHECK(same_values(load_scene(folder.path(), "SIM_001").classes, known.classes));

  rpc::write_geo_raster(classes_file, Tensor({3, H, W}), dsm.grid);
  CHECK(refusal() == classes_file + ": 3 bands, expected one");
  rpc::write_geo_raster(dsm_file, Tensor({2, H, W}), dsm.grid);
  CHECK(refusal() == dsm_file + ": 2 bands, expected one");
}

TEST_CASE("the truth lies in the zone that it names, whichever the images lie in") {
  const TempFolder folder("dataset-8");
  const SimulatedScene made = simulate_scene(small_scene(), 3, 0);
  write_scene(made, folder.path(), "SIM_001");
  const std::string dsm_file = (folder / "Track3-Truth/SIM_001_DSM.tif").string(),
                    classes_file = (folder / "Track3-Truth/SIM_001_CLS.tif").string();
  const rpc::UtmZone own = made.frame.zone, next{own.number % 60 + 1, own.north};
  const Scene known = load_scene(folder.path(), "SIM_001");
  REQUIRE(known.frame.zone == own);

  // the same north-western corner in the next zone
  const rpc::GeoRaster dsm = rpc::read_geo_raster(dsm_file, own);
  const auto [lon, lat] = rpc::geodetic_from_utm(own, dsm.grid.x0, dsm.grid.y0);
  const auto corner = rpc::utm_from_geodetic(next, lon, lat);
  rpc::GeoGrid there = dsm.grid;
  there.epsg = next.epsg(), there.x0 = corner[0], there.y0 = corner[1];
  rpc::write_geo_raster(dsm_file, dsm.values, there);
  std::filesystem::remove(classes_file);
  const auto lies_there = [&](const Scene& scene) {
    CHECK(scene.frame.zone == next);
    REQUIRE(scene.truth.has_value());
    const rpc::Geodetic p = scene.frame.geodetic_from_local({scene.truth->x0, scene.truth->y0, 0});
    CHECK(p.lon == doctest::Approx(lon).epsilon(1e-10));
    CHECK(p.lat == doctest::Approx(lat).epsilon(1e-10));
    const rpc::Geodetic middle = scene.frame.geodetic_from_local({0, 0, 0});
    for (const View& v : scene.views) CHECK(v.contains({middle.lon, middle.lat, made.frame.h0}));
  };
  lies_there(load_scene(folder.path(), "SIM_001"));
  // classes that name no system lie in the truth's, others where they say
  rpc::GeoGrid classes = there;
  classes.epsg = 0;
  rpc::write_geo_raster(classes_file, Tensor(dsm.values.shape(), 2.0F), classes);
  lies_there(load_scene(folder.path(), "SIM_001"));
  classes.epsg = own.epsg();
  rpc::write_geo_raster(classes_file, Tensor(dsm.values.shape(), 2.0F), classes);
  const auto refusal = [&] {
    return error_of<IoError>([&] { load_scene(folder.path(), "SIM_001"); });
  };
  CHECK(refusal().find(" in EPSG:" + std::to_string(own.epsg()) + ", expected the grid of ") !=
        std::string::npos);

  for (const int epsg : {2154, 32662}) {
    CAPTURE(epsg);
    there.epsg = epsg;
    if (epsg == 32662) there.x0 = lon * 111000, there.y0 = lat * 111000;  // metres, but no zone
    rpc::write_geo_raster(dsm_file, dsm.values, there);
    CHECK(refusal() == dsm_file + ": in EPSG:" + std::to_string(epsg) +
                           ", expected a zone of UTM; warp it first (gdalwarp)");
  }
  rpc::write_geo_raster(dsm_file, dsm.values, dsm.grid);
  {
    CPLPushErrorHandler(CPLQuietErrorHandler);  // the file is no longer laid out for the cloud
    const std::unique_ptr<GDALDataset> d(GDALDataset::Open(dsm_file.c_str(), GDAL_OF_UPDATE));
    OGRSpatialReference crs;
    REQUIRE(crs.importFromProj4("+proj=tmerc +lat_0=3 +lon_0=7 +x_0=11 +ellps=GRS80 +units=m") ==
            OGRERR_NONE);
    REQUIRE(d->SetSpatialRef(&crs) == CE_None);
  }
  CPLPopErrorHandler();
  CHECK(refusal().starts_with(dsm_file + ": in a system without a code of EPSG, expected a zone "));
  // a file without a system lies in the zone of the images, as the contest's do
  there = dsm.grid, there.epsg = 0;
  rpc::write_geo_raster(dsm_file, dsm.values, there);
  std::filesystem::remove(classes_file);
  CHECK(load_scene(folder.path(), "SIM_001").frame == known.frame);
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

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/rpc/raster.h"
#include "satsurf/train/evaluate.h"

#include <cmath>
#include <filesystem>
#include <limits>

#include <doctest/doctest.h>
#include <nlohmann/json.hpp>

using namespace satsurf;
using namespace satsurf::train;
namespace fs = std::filesystem;

namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

struct Folder {
  fs::path path = fs::temp_directory_path() / "satsurf_test_evaluate";
  Folder() {
    fs::remove_all(path);
    fs::create_directories(path);
  }
  ~Folder() { fs::remove_all(path); }
};

SceneScores scores(const std::string& name, double mae, double psnr_db) {
  SceneScores s;
  s.name = name;
  s.dsm.registered.mae = mae, s.dsm.registered.pag2_5 = 0.5;
  s.dsm.raw.mae = 2 * mae;
  s.dsm.shift = {0, 0, -1.5};
  s.target_psnr = psnr_db;
  return s;
}

}  // namespace

TEST_CASE("not_water") {
  const Tensor mask = not_water(Tensor::from({2, 3}, {2, 9, 5, 9, 65, 6}));
  const float expected[] = {1, 0, 1, 0, 1, 1};
  for (Index i = 0; i < 6; ++i) CHECK(mask[i] == expected[i]);
}

TEST_CASE("scores of a data set") {
  const std::vector<SceneScores> all{scores("a", 1, 20), scores("b", 3, kNan)};
  const auto j = scores_json(all);
  CHECK(j["mean"]["dsm_mae"] == 2);
  CHECK(j["mean"]["render_target_psnr"] == 20);  // of the scene that has one
  CHECK(j["scenes"][0]["dsm"]["raw"]["mae"] == 2);
  CHECK(j["scenes"][0]["dsm"]["shift_m"][2] == -1.5);
  CHECK(j["scenes"][1]["render_target_psnr"].is_null());
  const std::string csv = scores_csv(all);
  CHECK(csv.starts_with("scene,dsm_mae,dsm_rmse,dsm_median,dsm_nmad,dsm_pag1,dsm_pag2.5,"));
  CHECK(csv.find("\na,1,0,0,0,0,0.5,") != std::string::npos);
  CHECK(csv.find("\nmean,2,") != std::string::npos);
  CHECK(csv.find("nan") == std::string::npos);
  CHECK(scores_csv({}).empty());
}

TEST_CASE("load_dsm_pair") {
  const Folder folder;
  const rpc::GeoGrid grid{32617, 435000.25, 3354000.5, 0.5};
  rpc::write_geo_raster(folder.path / "truth.tif", Tensor::from({2, 3}, {1, 2, 3, 4, 5, 6}), grid);
  rpc::GeoGrid moved = grid;
  moved.x0 += 2, moved.y0 -= 1, moved.step = 0.3;
  rpc::write_geo_raster(folder.path / "found.tif", Tensor::from({1, 2}, {7, 8}), moved);
  const DsmPair pair = load_dsm_pair(folder.path / "found.tif", folder.path / "truth.tif");
  CHECK(pair.truth.x0 == doctest::Approx(0.25));
  CHECK(pair.prediction.x0 == doctest::Approx(2.25));
  CHECK(pair.prediction.y0 - pair.truth.y0 == doctest::Approx(-1));
  CHECK(pair.prediction.step == 0.3);
  REQUIRE(pair.frame);
  CHECK(pair.frame->zone == rpc::UtmZone{17, true});
  CHECK(pair.frame->easting0 == 435000);
  CHECK(pair.truth.z[5] == 6);

  moved.epsg = 32618;
  rpc::write_geo_raster(folder.path / "other.tif", Tensor({1, 2}), moved);
  CHECK_THROWS_WITH_AS(
      load_dsm_pair(folder.path / "other.tif", folder.path / "truth.tif"),
      ("evaluate: " + (folder.path / "other.tif").string() + " is in EPSG:32618 and " +
       (folder.path / "truth.tif").string() +
       " in EPSG:32617, wanted one system for both; gdalwarp brings one into the other")
          .c_str(),
      IoError);
}

TEST_CASE("seen_by_two: only ground inside two images counts") {
  // Cameras straight down, 1 m per pixel near the equator: a sees x in [-20, 20], b the same moved
  // 10 m east
  const rpc::LocalFrame frame{{31, true}, 500000, 100000, 0};
  const rpc::Geodetic origin = frame.geodetic_from_local({0, 0, 0});
  const auto camera = [&](double east) {
    rpc::Rpc r;
    const rpc::Geodetic p = frame.geodetic_from_local({east, 0, 0}),
                        q = frame.geodetic_from_local({east + 20, 20, 0});
    r.samp_off = r.line_off = 19.5, r.samp_scale = r.line_scale = 20;
    r.lon_off = p.lon, r.lat_off = p.lat, r.lon_scale = q.lon - p.lon, r.lat_scale = q.lat - p.lat;
    r.height_scale = 100;
    r.samp_num[1] = 1, r.line_num[2] = -1, r.samp_den[0] = r.line_den[0] = 1;
    return r;
  };
  REQUIRE(std::abs(origin.lat) < 2);
  HeightField truth{Tensor({60, 80}), -40, 30, 1};
  truth.z[30 * 80 + 45] = static_cast<float>(kNan);
  const std::vector<ImageCamera> both{{camera(0), 40, 40}, {camera(10), 40, 40}};
  const Tensor mask = seen_by_two(truth, frame, both);
  Index n = 0;
  for (const float v : mask.values()) n += v > 0;
  CHECK(n == 30 * 40 - 1);         // x in [-10, 20], y in [-20, 20], less the unknown cell
  CHECK(mask[30 * 80 + 29] == 0);  // x = -10.5
  CHECK(mask[30 * 80 + 30] == 1);  // x = -9.5
  CHECK(mask[30 * 80 + 45] == 0);  // unknown
  const Tensor one = seen_by_two(truth, frame, {both[0]});
  for (const float v : one.values()) REQUIRE(v == 0);
}

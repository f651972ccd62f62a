// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/confidence_figure.h"
#include "satsurf/app/scores_json.h"
#include "satsurf/core/parallel.h"
#include "satsurf/core/var.h"
#include "satsurf/evaluate/evaluate.h"
#include "satsurf/evaluate/table.h"
#include "satsurf/mesh/compare.h"
#include "satsurf/reconstruct/laid_surfels.h"
#include "satsurf/reconstruct/reconstruct.h"
#include "satsurf/reconstruct/rendered_view.h"
#include "satsurf/rpc/raster.h"
#include "satsurf/scene/crop.h"
#include "satsurf/scene/dataset.h"
#include "satsurf/scene/simulate/scene.h"
#include "satsurf/splat/view.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <limits>
#include <string>
#include <vector>

#include "tests/small_lpips.h"
#include "tests/temp_folder.h"
#include <doctest/doctest.h>
#include <nlohmann/json.hpp>

using namespace satsurf;
using namespace satsurf::app;
using namespace satsurf::evaluate;

using namespace satsurf::scene;
using satsurf::test::error_of;
using satsurf::test::small_lpips;
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
  s.target.psnr = psnr_db, s.target.psnr_fitted = psnr_db + 2, s.target.ssim = 0.75;
  s.target_covered = 0.5 * mae;
  s.registered[2].filled.mae = 3 * mae, s.registered[2].shift = {0.5, -1, 2};
  return s;
}

std::vector<std::string> parts_of(const std::string& text, char separator) {
  std::vector<std::string> parts{""};
  for (const char c : text)
    if (c == separator)
      parts.emplace_back();
    else
      parts.back() += c;
  return parts;
}
std::vector<std::string> cells_of(const std::string& row) { return parts_of(row, ','); }
std::vector<std::string> lines_of(const std::string& text) {
  std::vector<std::string> lines = parts_of(text, '\n');
  lines.pop_back();  // after the last line's end
  return lines;
}

/// A small made-up scene with four views, as read from disk.
Scene small_scene(const fs::path& folder) {
  SimulateConfig c = SimulateConfig();
  c.pixels = 64, c.views = 4, c.gsd = 0.5;
  write_scene(simulate_scene(c, 21, 0), folder, "SIM_001");
  return load_scene(folder, "SIM_001");
}

/// Level discs at the cells of a surface, moved by some metres. Every other number is made up.
splat::Surfels discs(const HeightField& field, const std::array<double, 3>& by) {
  const Index W = field.z.dim(1);
  std::vector<float> means;
  for (Index i = 0; i < field.z.count(); ++i) {
    const auto z = static_cast<double>(field.z[i]);
    if (!std::isfinite(z)) continue;
    const double at[3] = {field.x0 + (static_cast<double>(i % W) + 0.5) * field.step,
                          field.y0 - (static_cast<double>(i / W) + 0.5) * field.step, z};
    for (std::size_t a = 0; a < 3; ++a) means.push_back(static_cast<float>(at[a] + by[a]));
  }
  const Index P = static_cast<Index>(means.size()) / 3;
  Tensor quats({P, 4});
  for (Index p = 0; p < P; ++p) quats[4 * p] = 1;
  return {Var(Tensor::from({P, 3}, means)),
          Var(quats),
          Var(Tensor({P, 2}, static_cast<float>(0.5 * field.step))),
          Var(Tensor({P}, 0.98f)),
          Var(Tensor({P, 3}, 0.5f)),
          Var(Tensor({P, 1}, 0.9f))};
}

/// A mask of the cells within some metres of a point.
Tensor around(const HeightField& field, double x, double y, double radius) {
  Tensor mask(field.z.shape());
  const Index W = field.z.dim(1);
  for (Index i = 0; i < mask.count(); ++i) {
    const double dx = field.x0 + (static_cast<double>(i % W) + 0.5) * field.step - x,
                 dy = field.y0 - (static_cast<double>(i / W) + 0.5) * field.step - y;
    mask[i] = std::max(std::abs(dx), std::abs(dy)) < radius ? 1.f : 0.f;
  }
  return mask;
}

/// Of the truth's cells, easting and northing.
std::array<double, 2> corner_of(const Scene& scene) {
  return {scene.truth->x0 + scene.frame.easting0, scene.truth->y0 + scene.frame.northing0};
}

/// The true cells that two of the first three views see and that are no water.
Tensor scored_cells(const Scene& scene) {
  std::vector<ImageCamera> cameras;
  for (std::size_t i = 0; i < 3; ++i) {
    const View& v = scene.views[i];
    cameras.push_back({v.rpc, v.rgb.dim(2), v.rgb.dim(1)});
  }
  Tensor mask = seen_by_two(*scene.truth, scene.frame, cameras);
  const Tensor dry = not_water(scene.classes);
  for (Index i = 0; i < mask.count(); ++i) mask[i] *= dry[i];
  return mask;
}

/// What is said of views is what the window about the middle shows: of sources all pixels, of the
/// target's colours those that surfels cover.
/// surfels  that were scored
void check_views(const SceneScores& s, const nn::Model& model, const Scene& scene,
                 const splat::Surfels& surfels) {
  const NoGrad no_grad;
  const HeightField& truth = *scene.truth;
  const Index h = truth.z.dim(0), w = truth.z.dim(1);
  const float middle = truth.z[h / 2 * w + w / 2];
  REQUIRE(std::isfinite(middle));
  Crop crop = make_crop(scene, {.sources = {0, 1, 2},
                                .target = 3,
                                .centre = {truth.x0 + truth.step * static_cast<double>(w) / 2,
                                           truth.y0 - truth.step * static_cast<double>(h) / 2,
                                           static_cast<double>(middle)},
                                .size = {64, 64},
                                .z_range = scene.z_range,
                                .with_truth = true});
  forget_unseen_truth(crop);
  const auto stages = model.forward(crop.input);
  double squares = 0, n = 0;
  for (Index i = 0; i < 3; ++i) {
    const Tensor found = stages[2].height.value().slice0(i),
                 &known = crop.source_truth[2][static_cast<std::size_t>(i)];
    for (Index p = 0; p < known.count(); ++p)
      if (std::isfinite(known[p])) {
        const auto error = static_cast<double>(found[p] - known[p]);
        squares += error * error, n += 1;
      }
  }
  CHECK(s.mvs_source.rmse == doctest::Approx(std::sqrt(squares / n)).epsilon(1e-6));

  const auto shown = splat::render_view(surfels, crop.target->pixel_from_local, 64, 64, 1);
  const Tensor colours = splat::surface_colours(shown);
  const Tensor &rgb = crop.target->rgb, &valid = crop.target->valid;
  double valid_pixels = 0, covered = 0, difference = 0, bare = 0;
  for (Index p = 0; p < valid.count(); ++p) {
    if (!(valid[p] > 0)) continue;
    const bool covers = shown.alpha.value()[p] >= 0.5f;
    valid_pixels += 1, covered += covers ? 1 : 0;
    for (Index c = 0; c < 3; ++c) {
      const Index at = c * valid.count() + p;
      const double d = std::clamp(static_cast<double>(colours[at]), 0., 1.) -
                       std::clamp(static_cast<double>(rgb[at]), 0., 1.);
      (covers ? difference : bare) += d * d;
    }
  }
  REQUIRE(bare > 0);  // what is not covered would change the score
  CHECK(s.target_covered == doctest::Approx(covered / valid_pixels));
  CHECK(s.target.psnr ==
        doctest::Approx(-10 * std::log10(difference / (3 * covered))).epsilon(1e-6));
}

/// All numbers but the time.
std::string text_of(DataScores scores) {
  for (SceneScores& s : scores.scenes) s.seconds = 0;
  return scores_json(scores).dump(1) + scores_csv(scores.scenes);
}

}  // namespace

TEST_CASE("not_water") {
  const Tensor mask = not_water(Tensor::from({2, 3}, {2, 9, 5, 9, 65, 6}));
  const float expected[] = {1, 0, 1, 0, 1, 1};
  for (Index i = 0; i < 6; ++i) CHECK(mask[i] == expected[i]);
}

TEST_CASE("expected errors are scored by the cells whose error is within one and two of them") {
  const auto nan = static_cast<float>(kNan);
  const SigmaScore s = score_sigma(Tensor::from({1, 5}, {1, 1, 1, 1, nan}),
                                   Tensor::from({1, 5}, {0.5f, -1.5f, 3, nan, 0}));
  CHECK(s.within_1 == doctest::Approx(1. / 3));
  CHECK(s.within_2 == doctest::Approx(2. / 3));
  const SigmaScore none = score_sigma(Tensor({1, 2}, nan), Tensor({1, 2}));
  CHECK(std::isnan(none.within_1));
  CHECK(std::isnan(none.within_2));
  CHECK_THROWS_AS(score_sigma(Tensor({1, 2}), Tensor({2, 1})), ShapeError);
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
  // every row has every column, and the mean those of the JSON
  const auto rows = lines_of(csv);
  REQUIRE(rows.size() == 4);
  const std::vector<std::string> names = cells_of(rows[0]);
  CHECK(names.size() == 1 + 9 * 13 + 3 * 3 + 2 * 6 + kCauses * 6 + 2 + 4 + 8);
  for (const std::string& row : rows) CHECK(cells_of(row).size() == names.size());
  REQUIRE(j["mean"].size() == names.size() - 1);
  Index column = 1;
  for (const auto& [name, value] : j["mean"].items())
    CHECK(names[static_cast<std::size_t>(column++)] == name);
  const auto at = [&](const char* name) {
    return static_cast<std::size_t>(std::find(names.begin(), names.end(), name) - names.begin());
  };
  CHECK(cells_of(rows[2])[at("dsm_filled_xyz_mae")] == "9");
  CHECK(cells_of(rows[2])[at("dsm_xyz_north")] == "-1");
  CHECK(cells_of(rows[2])[at("render_target_psnr")].empty());
  CHECK(cells_of(rows[3])[at("dsm_filled_xyz_mae")] == "6");
  CHECK(cells_of(rows[3])[at("render_target_psnr")] == "20");
  CHECK(cells_of(rows[1])[at("render_target_psnr_fitted")] == "22");
  CHECK(cells_of(rows[3])[at("render_target_lpips")].empty());
  CHECK(cells_of(rows[2])[at("render_target_covered")] == "1.5");
  CHECK(at("render_target_covered") == at("render_target_lpips") + 1);
  CHECK(j["scenes"][0]["render_target_covered"] == 0.5);
  CHECK(j["mean"]["render_target_covered"] == 1);
  // over how many scenes a mean is, where these are not all
  CHECK(j["mean_scenes"]["render_target_psnr"] == 1);
  CHECK(j["mean_scenes"]["mesh_chamfer"] == 0);
  CHECK_FALSE(j["mean_scenes"].contains("dsm_mae"));
  CHECK(j["mean"]["render_target_ssim"] == 0.75);
  CHECK(j["mean"]["render_target_lpips"].is_null());
  CHECK(j["lpips_backbone"].is_null());
  const auto& xyz = j["scenes"][1]["dsm_by_registration"]["xyz"];
  CHECK(xyz["holes_filled"]["mae"] == 9);
  CHECK(xyz["shift_m"][0] == 0.5);
  CHECK(csv.find("\nmean,2,") != std::string::npos);
  CHECK(csv.find("nan") == std::string::npos);
  CHECK(scores_csv({}).empty());

  const std::string odd = scores_csv({scores("a, \"b\"", 1, 20), scores("c d", 1, 20)});
  CHECK(odd.find("\n\"a, \"\"b\"\"\",1,0,") != std::string::npos);
  CHECK(odd.find("\nc d,1,0,") != std::string::npos);
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
  CHECK(pair.east == 435000);
  CHECK(pair.north == 3354001);  // half goes up
  CHECK(pair.epsg == 32617);
  CHECK(pair.geo_grid(pair.truth) == grid);

  // a system of another kind gives no frame but a place all the same
  rpc::GeoGrid lambert = grid;
  lambert.epsg = 2154;
  rpc::write_geo_raster(folder.path / "lambert.tif", Tensor({2, 3}), lambert);
  rpc::GeoGrid unnamed = moved;
  unnamed.epsg = 0;
  rpc::write_geo_raster(folder.path / "unnamed.tif", Tensor({1, 2}), unnamed);
  for (const auto& [found, truth] :
       {std::pair{"unnamed.tif", "lambert.tif"}, std::pair{"lambert.tif", "unnamed.tif"}}) {
    const DsmPair other = load_dsm_pair(folder.path / found, folder.path / truth);
    CHECK_FALSE(other.frame.has_value());
    CHECK(other.epsg == 2154);
    CHECK(other.geo_grid(other.truth).x0 ==
          doctest::Approx(truth == std::string("lambert.tif") ? 435000.25 : 435002.25)
              .epsilon(1e-12));
  }
  CHECK(load_dsm_pair(folder.path / "unnamed.tif", folder.path / "unnamed.tif").epsg == 0);

  moved.epsg = 32618;
  rpc::write_geo_raster(folder.path / "other.tif", Tensor({1, 2}), moved);
  CHECK_THROWS_WITH_AS(
      load_dsm_pair(folder.path / "other.tif", folder.path / "truth.tif"),
      ("evaluate: " + (folder.path / "other.tif").string() + " is in EPSG:32618 and " +
       (folder.path / "truth.tif").string() +
       " in EPSG:32617, expected one system for both; gdalwarp brings one into the other")
          .c_str(),
      IoError);
}

TEST_CASE("covered_share") {
  const Tensor alpha = Tensor::from({2, 3}, {0.25f, 0.5f, 1, 0.75f, 0.49f, 1});
  CHECK(covered_share(alpha, Tensor::from({2, 3}, {1, 1, 0, 1, 0, 1})) == 0.75);
  CHECK(covered_share(alpha, Tensor::from({2, 3}, {1, 0, 0, 0, 1, 0})) == 0);
  CHECK(std::isnan(covered_share(alpha, Tensor({2, 3}))));
  CHECK(error_of<ShapeError>([&] {
          covered_share(alpha, Tensor({3, 2}));
        }) ==
        "covered_share: valid has shape [3,2], expected [H W] with H=2 from alpha, W=3 from alpha");
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

TEST_CASE("what cameras see of the true surface, and of a part of it") {
  const Folder folder;
  const Scene scene = small_scene(folder.path);
  const View& view = scene.views[1];
  mesh::HeightImage seen =
      reconstruct::true_view(*scene.truth, posed_image(view, scene.frame, scene.z_range));
  const HeightField& field = *scene.truth;
  Index known = 0, below = 0;
  for (Index y = 0; y < 64; ++y)
    for (Index x = 0; x < 64; ++x) {
      const double z = static_cast<double>(seen.height[y * 64 + x]);
      if (!std::isfinite(z)) continue;
      known += 1;
      const auto p = seen.local_from_pixel(static_cast<double>(x), static_cast<double>(y), z);
      const auto q = seen.pixel_from_local(p[0], p[1], z);
      REQUIRE(std::hypot(q[0] - static_cast<double>(x), q[1] - static_cast<double>(y)) < 0.05);
      const auto i = static_cast<Index>((field.y0 - p[1]) / field.step),
                 j = static_cast<Index>((p[0] - field.x0) / field.step);
      below += static_cast<double>(field.z[i * field.z.dim(1) + j]) < z - 0.01;  // hit a wall
    }
  CHECK(known > 2000);
  CHECK(below < known / 4);
  Tensor west(field.z.shape());
  for (Index i = 0; i < west.count(); ++i)
    west[i] = i % field.z.dim(1) < field.z.dim(1) / 2 ? 1.f : 0.f;
  const Tensor all = seen.height.clone();
  reconstruct::keep_inside(seen, field, west);
  Index kept = 0;
  for (Index i = 0; i < all.count(); ++i) {
    if (!std::isfinite(all[i])) continue;
    const auto p = seen.local_from_pixel(static_cast<double>(i % 64), static_cast<double>(i / 64),
                                         static_cast<double>(all[i]));
    const bool inside = p[0] < field.x0 + field.step * static_cast<double>(field.z.dim(1) / 2);
    REQUIRE(std::isfinite(seen.height[i]) == inside);
    kept += inside;
  }
  CHECK(kept > known / 4);
  CHECK(kept < known * 3 / 4);
}

TEST_CASE("a surface that lies wrong is compared where its shift puts it") {
  const Folder folder;
  const Scene scene = small_scene(folder.path);
  const HeightField& truth = *scene.truth;
  const Tensor mask = around(truth, 0, 0, 8);
  std::vector<nn::PosedImage> images;
  for (const View& view : scene.views)
    images.push_back(posed_image(view, scene.frame, scene.z_range));
  const auto compared = [&](const std::array<double, 3>& by, const std::array<double, 3>& shift) {
    const auto c = compare_surfaces(discs(truth, by), truth, images, mask, shift, 1);
    REQUIRE(c);
    return c->without_walls;
  };
  const mesh::SurfaceScores right = compared({0, 0, 0}, {0, 0, 0});
  CHECK(right.f[1].f1 > 0.9);

  // 2 m too high, as a wrong datum leaves it
  const mesh::SurfaceScores high = compared({0, 0, 2}, {0, 0, 0}),
                            lowered = compared({0, 0, 2}, {0, 0, -2});
  CHECK(high.f[1].f1 < 0.3);
  CHECK(high.chamfer > right.chamfer + 1);
  CHECK(lowered.f[1].f1 > right.f[1].f1 - 0.05);
  CHECK(std::abs(lowered.chamfer - right.chamfer) < 0.1);

  // 6 m too far east: the cells are those where the surface comes to lie, else its edges miss
  const mesh::SurfaceScores moved = compared({6, 0, 0}, {-6, 0, 0});
  CHECK(moved.f[1].precision > right.f[1].precision - 0.1);
  CHECK(moved.f[1].recall > right.f[1].recall - 0.1);

  CHECK_FALSE(
      compare_surfaces(discs(truth, {0, 0, 0}), truth, images, Tensor(mask.shape()), {0, 0, 0}, 1));
}

TEST_CASE("a scene's scores") {
  const Folder folder;
  const Scene scene = small_scene(folder.path);
  const nn::Model model(nn::model_preset("tiny"), 3);
  const nn::Lpips lpips = small_lpips();
  EvaluateOptions options;
  options.registration = Registration::z;
  options.lpips = &lpips;

  const auto scored = [&](int n) {
    const int before = threads();
    set_threads(n);
    DataScores out;
    out.scenes.push_back(evaluate_scene(model, scene, options, &out.confidence));
    set_threads(before);
    return out;
  };
  const DataScores all = scored(1);
  CHECK(text_of(all) == text_of(scored(2)));  // to the bit

  const SceneScores& s = all.scenes[0];
  REQUIRE(s.dsm.registered.compared > 100);
  const auto& [none, z, xyz] = s.registered;
  CHECK(none.scores.mae == s.dsm.raw.mae);
  CHECK(z.scores.mae == s.dsm.registered.mae);  // what was asked for
  CHECK(z.shift == s.dsm.shift);
  CHECK(none.shift == std::array<double, 3>{0, 0, 0});
  CHECK(xyz.scores.truth > 0);
  for (const RegisteredScores& r : s.registered) {
    CHECK(r.filled.truth == r.scores.truth);
    CHECK(r.filled.compared == r.filled.truth);
    CHECK(r.filled.pag2_5 >= r.scores.pag2_5);  // cells that were known stay as they were
  }
  CHECK(s.mvs_source.compared == all.confidence.mvs_source.pixels());
  CHECK(s.dsm.registered.compared == all.confidence.dsm.pixels());
  // not the same, but views of one scene are alike
  CHECK(s.mvs_source_rmse_per_view != s.mvs_source.rmse);
  CHECK(s.mvs_source_rmse_per_view == doctest::Approx(s.mvs_source.rmse).epsilon(0.1));
  CHECK(std::isfinite(s.target.psnr));
  CHECK(std::isfinite(s.target.ssim));
  CHECK(s.target.ssim_conv < 1);
  CHECK(s.target.lpips.value() > 0);
  CHECK(s.target_covered > 0);
  CHECK(s.target_covered <= 1);
  CHECK(s.dsm.error.empty());  // scores only
  // causes are of the filled surface, registered as asked, and the flags of the sources alone
  double share = 0, error_share = 0;
  for (const Cause cause : {Cause::rim, Cause::open_ground, Cause::hidden, Cause::shadow}) {
    const CauseScore& c = s.causes[static_cast<std::size_t>(cause)];
    REQUIRE(c.cells > 0);
    CHECK(c.share == doctest::Approx(c.cells / static_cast<double>(z.filled.truth)));
    CHECK(c.error_share == doctest::Approx(c.share * c.mae / z.filled.mae));
    share += c.share, error_share += c.error_share;
  }
  CHECK(share > 0.5);
  CHECK(error_share > 0.5);
  CHECK(s.causes[static_cast<std::size_t>(Cause::water)].cells == 0);  // masked out
  CHECK(s.oracle.mae > 0);
  CHECK(s.oracle.mae < 1.2 * z.filled.mae);  // where no surfel is, it is filled, too
  for (const double lost : s.lost) CHECK((lost >= 0 && lost < 1));
  REQUIRE(s.mesh);
  CHECK(s.mesh->without_walls.mesh_samples < s.mesh->all.mesh_samples);
  {  // meshes are compared after the DSM's shift, above the DSM's cells
    Scene seen = scene;
    seen.views.resize(3);
    reconstruct::ReconstructOptions how;
    how.resolution = scene.truth->step, how.cell_corner = corner_of(scene), how.mesh = 0;
    const reconstruct::Reconstruction made = reconstruct::reconstruct(model, seen, how);
    const Tensor mask = scored_cells(scene);
    std::vector<nn::PosedImage> images = made.images;
    for (std::size_t i = 3; i < scene.views.size(); ++i)
      images.push_back(posed_image(scene.views[i], scene.frame, scene.z_range));
    const auto compared = [&](const std::array<double, 3>& shift) {
      const auto c = compare_surfaces(made.surfels, *scene.truth, images, mask, shift, made.voxel);
      REQUIRE(c);
      return scores_json(*c).dump();
    };
    REQUIRE(s.dsm.shift[2] != 0);
    CHECK(compared(s.dsm.shift) == scores_json(*s.mesh).dump());
    CHECK(compared({0, 0, 0}) != scores_json(*s.mesh).dump());
    check_views(s, model, scene, reconstruct::delivered_surfels(made));
  }
  const auto j = scores_json(all);
  CHECK(j["mean"]["mesh_chamfer"] == s.mesh->all.chamfer);
  CHECK(j["mean"]["mesh_without_walls_f1_2.5"] == s.mesh->without_walls.f[2].f1);
  CHECK(j["scenes"][0]["mesh"]["recall"]["1"] == s.mesh->all.f[1].recall);
  CHECK(j["lpips_backbone"] == "alex");
  CHECK(j["mean"]["render_target_lpips"] == *s.target.lpips);
  CHECK(j["scenes"][0]["causes"]["rim"]["mae"] == j["mean"]["cause_rim_mae"]);
  CHECK(j["scenes"][0]["lost"]["stage2"] == j["mean"]["lost_stage2"]);
  CHECK(j["scenes"][0]["oracle"]["mae"] == s.oracle.mae);
  for (const char* of : {"mvs_source", "dsm"}) {
    CHECK(j["confidence"][of]["equal_width"].size() == 10);
    CHECK(j["confidence"][of]["monotone"].is_boolean());
  }

  SUBCASE("a longer range is searched for the surface alone") {
    options.lpips = nullptr, options.meshes = false;
    const auto heights = [](const SceneScores& t) {
      std::string text;
      for (const RegisteredScores& r : t.registered)
        text += scores_json(r.scores).dump() + scores_json(r.filled).dump();
      return text;
    };
    Scene higher = scene;
    higher.z_range.high += 40;
    const std::string raised = heights(evaluate_scene(model, higher, options));
    options.range_above = 40;
    const SceneScores above = evaluate_scene(model, scene, options);
    CHECK(heights(above) == raised);
    CHECK(heights(above) != heights(s));
    CHECK(scores_json(above.mvs_source) == scores_json(s.mvs_source));
  }
  SUBCASE("expected errors are scored where the surface has come to lie") {
    const nn::SurfaceModel network({.base = 3}, 5);
    options.network = &network, options.lpips = nullptr, options.meshes = false;
    options.registration = Registration::xyz;
    const SceneScores t = evaluate_scene(model, scene, options);
    Scene seen = scene;
    seen.views.resize(3);
    reconstruct::ReconstructOptions how;
    how.resolution = scene.truth->step, how.cell_corner = corner_of(scene);
    how.network = &network;
    const reconstruct::Reconstruction made = reconstruct::reconstruct(model, seen, how);
    const DsmComparison c =
        compare_dsm(made.dsm, *scene.truth, Registration::xyz, scored_cells(scene));
    const HeightField sigma{made.sigma, made.dsm.x0 + c.shift[0], made.dsm.y0 + c.shift[1],
                            made.dsm.step};
    const SigmaScore expected = score_sigma(resample(sigma, *scene.truth), c.error);
    CHECK(t.sigma.within_1 == expected.within_1);
    CHECK(t.sigma.within_2 == expected.within_2);
    CHECK(t.sigma.within_1 > 0);
    CHECK(t.sigma.within_1 < t.sigma.within_2);
    CHECK(std::isnan(s.sigma.within_1));  // without a surface network there are none
    const auto table = scores_json(std::vector{t});
    CHECK(table["scenes"][0]["sigma"]["within_1"] == t.sigma.within_1);
    CHECK(table["mean"]["sigma_within_2"] == t.sigma.within_2);
  }
  SUBCASE("without a target nothing is said of one") {
    Scene fewer = scene;
    fewer.views.resize(3);
    const SceneScores t = evaluate_scene(model, fewer, options);
    CHECK(t.render_target.truth == 0);
    CHECK(std::isnan(t.render_target.mae));
    CHECK(std::isnan(t.target.psnr));
    CHECK(std::isnan(t.target_covered));
    CHECK(!t.target.lpips);
    CHECK(t.dsm.registered.mae == s.dsm.registered.mae);
    const auto mean = scores_json(std::vector{s, t})["mean"];
    CHECK(mean["render_target_mae"] == s.render_target.mae);
  }
  SUBCASE("a scene of which nothing comes is one of failures") {
    Scene blind = scene;
    for (std::size_t i = 0; i < 3; ++i) blind.views[i].valid = Tensor(scene.views[i].valid.shape());
    ConfidenceScores confidence;
    const SceneScores t = evaluate_scene(model, blind, options, &confidence);
    CHECK(t.dsm.registered.truth == s.dsm.registered.truth);
    for (const RegisteredScores& r : t.registered)
      for (const HeightScores& h : {r.scores, r.filled}) {
        CHECK(h.truth == s.dsm.registered.truth);
        CHECK(h.compared == 0);
        CHECK(h.completeness == 0);
        CHECK(h.pag7_5 == 0);
        CHECK(std::isnan(h.mae));
      }
    CHECK_FALSE(t.mesh);
    CHECK(confidence.dsm.pixels() == 0);
    const auto table = scores_json(std::vector{s, t});
    CHECK(table["mean"]["dsm_pag2.5"].get<double>() ==
          doctest::Approx(s.dsm.registered.pag2_5 / 2));
    CHECK(table["mean"]["dsm_mae"] == s.dsm.registered.mae);
    for (const char* name : {"dsm_mae", "dsm_filled_z_rmse", "mesh_chamfer", "mvs_source_mae"})
      CHECK(table["mean_scenes"][name] == 1);
    CHECK_FALSE(table["mean_scenes"].contains("dsm_pag2.5"));
  }
  SUBCASE("refusals") {
    Scene other = scene;
    other.views.resize(2);
    CHECK(error_of<IoError>([&] { evaluate_scene(model, other, options); }) ==
          folder.path.string() + ": 2 images of SIM_001, expected 3 or more");
    other = scene;
    other.truth.reset();
    CHECK(error_of<IoError>([&] { evaluate_scene(model, other, options); }) ==
          scene.truth_file.string() + ": no such file, expected the truth to score against");
    other = scene;
    other.classes = Tensor(scene.classes.shape(), 9.f);
    CHECK(
        error_of<IoError>([&] { evaluate_scene(model, other, options); }) ==
        scene.truth_file.string() +
            ": no height that counts, expected some that two of the first 3 images of SIM_001 see "
            "and that are no water");
    other.classes = Tensor({3, 4}, 2.f);
    CHECK(error_of<ShapeError>([&] {
            evaluate_scene(model, other, options);
          }).starts_with("evaluate: classes has shape [3,4], expected [H W] with "));
    int told = 0;
    options.progress = [&](const std::string&, double) {
      if (++told > 1) throw Error("enough");  // within the first scene
    };
    CHECK(error_of<Error>([&] { evaluate_data(model, folder.path, options); }) ==
          folder.path.string() + ": SIM_001: enough");
    options.progress = nullptr;
    options.window = 16;
    CHECK(error_of<IoError>([&] { evaluate_scene(model, scene, options); }) ==
          folder.path.string() + ": a window of 16 px in SIM_001, expected at least " +
              std::to_string(lpips.smallest_side()) + " px for LPIPS (alex)");
  }
}

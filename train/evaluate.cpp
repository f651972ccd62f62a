// SPDX-License-Identifier: Apache-2.0
#include "satsurf/train/evaluate.h"

#include "satsurf/core/parallel.h"
#include "satsurf/core/var.h"
#include "satsurf/train/reconstruct.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <limits>
#include <utility>

namespace satsurf::train {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kWaterClass = 9;  // of DFC2019

/// Joins maps of one width below each other, so that several views are scored as one.
Tensor stacked(const std::vector<Tensor>& maps) {
  Index rows = 0;
  for (const Tensor& m : maps) rows += m.dim(0);
  auto out = Tensor::uninitialised({rows, maps[0].dim(1)});
  float* to = out.data();
  for (const Tensor& m : maps) to = std::copy_n(m.data(), m.count(), to);
  return out;
}

/// Local z of the truth in the middle of its grid, or of the height range where it is unknown
/// there.
double middle_height(const Scene& scene) {
  const Tensor& z = scene.truth->z;
  const float v = z[z.dim(0) / 2 * z.dim(1) + z.dim(1) / 2];
  return std::isfinite(v) ? static_cast<double>(v) : (scene.z_low + scene.z_high) / 2;
}

/// Heights in the source views and the rendered target, in a window around the middle of the truth.
void score_views(const nn::Model& model, const Scene& scene, const EvaluateOptions& options,
                 const std::vector<Index>& sources, SceneScores& out) {
  const Index multiple = nn::size_multiple(model.config());
  Index side = options.window;
  for (const SceneView& v : scene.views) side = std::min({side, v.rgb.dim(1), v.rgb.dim(2)});
  side = std::max(multiple, side / multiple * multiple);
  const bool has_target = scene.views.size() > sources.size();
  const HeightField& truth = *scene.truth;
  const double x = truth.x0 + truth.step * static_cast<double>(truth.z.dim(1)) / 2;
  const double y = truth.y0 - truth.step * static_cast<double>(truth.z.dim(0)) / 2;
  const Crop crop = make_crop(
      scene, sources,
      has_target ? std::optional<Index>(static_cast<Index>(sources.size())) : std::nullopt, x, y,
      middle_height(scene), side, scene.z_low, scene.z_high, true);
  const auto stages = model.forward(crop.input);
  std::vector<Tensor> found, known;
  for (std::size_t i = 0; i < sources.size(); ++i) {
    found.push_back(stages[2].height.value().slice0(static_cast<Index>(i)));
    known.push_back(crop.source_truth[2][i].clone());
    for (Index p = 0; p < known[i].count(); ++p)
      if (crop.input.sources[i].valid[p] <= 0) known[i][p] = kNan;  // no image, nothing to find
  }
  out.mvs_source = score_heights(stacked(found), stacked(known));
  if (!has_target) return;

  const auto render =
      nn::render_view(stages[2].surfels, crop.target->pixel_from_local, side, side, 1);
  Tensor height = render.height.value().clone(), mask = crop.target->valid.clone();
  for (Index p = 0; p < height.count(); ++p)
    if (render.alpha.value()[p] < 0.5f) height[p] = kNan, mask[p] = 0;  // seen by no source view
  out.render_target = score_heights(height, crop.target_truth, crop.target->valid);
  out.target_psnr = psnr(render.colour.value(), crop.target->rgb, mask);
}

/// Names and values of the numbers that go into tables.
std::vector<std::pair<std::string, double>> row_of(const SceneScores& s) {
  return {{"dsm_mae", s.dsm.registered.mae},
          {"dsm_rmse", s.dsm.registered.rmse},
          {"dsm_median", s.dsm.registered.median},
          {"dsm_nmad", s.dsm.registered.nmad},
          {"dsm_pag1", s.dsm.registered.pag1},
          {"dsm_pag2.5", s.dsm.registered.pag2_5},
          {"dsm_pag7.5", s.dsm.registered.pag7_5},
          {"dsm_completeness", s.dsm.registered.completeness},
          {"mvs_source_mae", s.mvs_source.mae},
          {"mvs_source_pag2.5", s.mvs_source.pag2_5},
          {"mvs_source_pag7.5", s.mvs_source.pag7_5},
          {"render_target_mae", s.render_target.mae},
          {"render_target_pag2.5", s.render_target.pag2_5},
          {"render_target_pag7.5", s.render_target.pag7_5},
          {"render_target_psnr", s.target_psnr},
          {"seconds", s.seconds}};
}

/// JSON has no NaN; null says that a number does not exist.
nlohmann::ordered_json number(double v) {
  return std::isfinite(v) ? nlohmann::ordered_json(v) : nlohmann::ordered_json(nullptr);
}

}  // namespace

nlohmann::ordered_json scores_json(const HeightScores& s) {
  return {{"truth_cells", s.truth},
          {"compared_cells", s.compared},
          {"completeness", number(s.completeness)},
          {"mae", number(s.mae)},
          {"rmse", number(s.rmse)},
          {"median", number(s.median)},
          {"nmad", number(s.nmad)},
          {"pag1", number(s.pag1)},
          {"pag2.5", number(s.pag2_5)},
          {"pag7.5", number(s.pag7_5)},
          {"pag1_compared", number(s.pag1_compared)},
          {"pag2.5_compared", number(s.pag2_5_compared)},
          {"pag7.5_compared", number(s.pag7_5_compared)}};
}

nlohmann::ordered_json scores_json(const DsmComparison& c) {
  return {
      {"raw", scores_json(c.raw)}, {"registered", scores_json(c.registered)}, {"shift_m", c.shift}};
}

Tensor not_water(const Tensor& classes) {
  Tensor mask = classes.clone();
  for (float& v : mask.values()) v = v == kWaterClass ? 0.f : 1.f;
  return mask;
}

Tensor seen_by_two(const HeightField& truth, const rpc::LocalFrame& frame,
                   const std::vector<ImageCamera>& images) {
  const Index H = truth.z.dim(0), W = truth.z.dim(1);
  Tensor mask({H, W});
  for_each_index(H, [&](Index i) {
    for (Index j = 0; j < W; ++j) {
      const float z = truth.z[i * W + j];
      if (!std::isfinite(z)) continue;
      const rpc::Geodetic p = frame.geodetic_from_local(
          {truth.x0 + (static_cast<double>(j) + 0.5) * truth.step,
           truth.y0 - (static_cast<double>(i) + 0.5) * truth.step, static_cast<double>(z)});
      int seen = 0;
      for (const ImageCamera& image : images) {
        const rpc::Pixel q = image.rpc.project(p);
        seen += q.x >= -0.5 && q.y >= -0.5 && q.x < static_cast<double>(image.width) - 0.5 &&
                q.y < static_cast<double>(image.height) - 0.5;
      }
      mask[i * W + j] = seen >= 2 ? 1.f : 0.f;
    }
  });
  return mask;
}

DsmPair load_dsm_pair(const std::filesystem::path& prediction, const std::filesystem::path& truth) {
  const rpc::GeoRaster found = rpc::read_geo_raster(prediction),
                       known = rpc::read_geo_raster(truth);
  const int a = found.grid.epsg, b = known.grid.epsg;
  if (a != 0 && b != 0 && a != b) {
    std::string text = "evaluate: " + prediction.string() + " is in EPSG:";
    text += std::to_string(a) + " and " + truth.string() + " in EPSG:" + std::to_string(b);
    throw IoError(text + ", wanted one system for both; gdalwarp brings one into the other");
  }
  const double east = std::round(known.grid.x0), north = std::round(known.grid.y0);
  const auto field = [&](const rpc::GeoRaster& r) {
    const Tensor z = r.values.rank() == 3 ? r.values.slice0(0) : r.values;
    return HeightField{z, r.grid.x0 - east, r.grid.y0 - north, r.grid.step};
  };
  DsmPair pair{field(found), field(known), std::nullopt};
  const int epsg = b != 0 ? b : a, number = epsg % 100;
  if ((epsg / 100 == 326 || epsg / 100 == 327) && number >= 1 && number <= 60)
    pair.frame = rpc::LocalFrame{{number, epsg / 100 == 326}, east, north, 0};
  return pair;
}

SceneScores evaluate_scene(const nn::Model& model, const Scene& scene,
                           const EvaluateOptions& options) {
  if (static_cast<Index>(scene.views.size()) < options.views)
    throw IoError(scene.images.string() + ": " + std::to_string(scene.views.size()) +
                  " images of " + scene.name + ", wanted " + std::to_string(options.views) +
                  " or more");
  if (!scene.truth)
    throw IoError(scene.truth_file.string() + ": no such file, wanted the truth to score against");
  const NoGrad no_grad;
  std::vector<Index> sources;
  for (Index i = 0; i < options.views; ++i) sources.push_back(i);
  Scene seen = scene;
  seen.views.resize(static_cast<std::size_t>(options.views));

  SceneScores out;
  out.name = scene.name;
  const auto start = std::chrono::steady_clock::now();
  ReconstructOptions how;
  how.resolution = scene.truth->step;
  how.progress = options.progress;
  const Reconstruction made = reconstruct(model, seen, how);
  out.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  std::vector<ImageCamera> cameras;
  for (const SceneView& v : seen.views) cameras.push_back({v.rpc, v.rgb.dim(2), v.rgb.dim(1)});
  Tensor mask = seen_by_two(*scene.truth, scene.frame, cameras);
  if (options.mask_water && !scene.classes.empty()) {
    const Tensor dry = not_water(scene.classes);
    for (Index i = 0; i < mask.count(); ++i) mask[i] *= dry[i];
  }
  out.dsm = compare_dsm(made.dsm, *scene.truth, options.registration, mask);
  out.target_psnr = std::nan("");
  score_views(model, scene, options, sources, out);
  return out;
}

std::vector<SceneScores> evaluate_data(const nn::Model& model, const std::filesystem::path& folder,
                                       const EvaluateOptions& options) {
  const std::vector<std::string> names = list_scenes(folder);
  std::vector<SceneScores> scores;
  for (std::size_t i = 0; i < names.size(); ++i) {
    if (options.progress)
      options.progress("evaluate " + names[i],
                       static_cast<double>(i) / static_cast<double>(names.size()));
    EvaluateOptions inner = options;
    if (options.progress)  // a scene's own progress is a share of the whole
      inner.progress = [&](const std::string&, double f) {
        options.progress("evaluate " + names[i],
                         (static_cast<double>(i) + f) / static_cast<double>(names.size()));
      };
    scores.push_back(evaluate_scene(model, load_scene(folder, names[i]), inner));
  }
  return scores;
}

nlohmann::ordered_json scores_json(const std::vector<SceneScores>& scores) {
  nlohmann::ordered_json out{{"scenes", nlohmann::ordered_json::array()}};
  std::vector<std::pair<std::string, std::pair<double, int>>> sums;
  for (const SceneScores& s : scores) {
    out["scenes"].push_back({{"name", s.name},
                             {"dsm", scores_json(s.dsm)},
                             {"mvs_source", scores_json(s.mvs_source)},
                             {"render_target", scores_json(s.render_target)},
                             {"render_target_psnr", number(s.target_psnr)},
                             {"seconds", s.seconds}});
    const auto row = row_of(s);
    if (sums.empty())
      for (const auto& [name, value] : row) sums.push_back({name, {0, 0}});
    for (std::size_t k = 0; k < row.size(); ++k)
      if (std::isfinite(row[k].second))
        sums[k].second.first += row[k].second, sums[k].second.second += 1;
  }
  out["mean"] = nlohmann::ordered_json::object();
  for (const auto& [name, sum] : sums)
    out["mean"][name] = number(sum.second > 0 ? sum.first / sum.second : std::nan(""));
  return out;
}

std::string scores_csv(const std::vector<SceneScores>& scores) {
  if (scores.empty()) return {};
  std::string text = "scene";
  for (const auto& [name, value] : row_of(scores[0])) text += "," + name;
  text += "\n";
  const auto cell = [](double v) {
    char digits[32];
    std::snprintf(digits, sizeof digits, "%.6g", v);
    return std::isfinite(v) ? std::string(digits) : std::string();
  };
  for (const SceneScores& s : scores) {
    text += s.name;
    for (const auto& [name, value] : row_of(s)) text += "," + cell(value);
    text += "\n";
  }
  text += "mean";
  const nlohmann::ordered_json mean = scores_json(scores)["mean"];
  for (const auto& [name, value] : row_of(scores[0]))
    text += "," + (mean[name].is_null() ? std::string() : cell(mean[name].get<double>()));
  return text + "\n";
}

}  // namespace satsurf::train

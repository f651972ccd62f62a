// SPDX-License-Identifier: Apache-2.0
#include "satsurf/train/evaluate.h"
#include "satsurf/train/record.h"

#include <cmath>
#include <cstdio>
#include <limits>
#include <utility>

namespace satsurf::train {
namespace {

constexpr std::array<const char*, 3> kRegistrations{"none", "z", "xyz"};

using Row = std::vector<std::pair<std::string, double>>;

void add_heights(Row& row, const std::string& group, const HeightScores& s) {
  for (const auto& [name, value] : {std::pair<const char*, double>{"_mae", s.mae},
                                    {"_rmse", s.rmse},
                                    {"_median", s.median},
                                    {"_nmad", s.nmad},
                                    {"_pag1", s.pag1},
                                    {"_pag2.5", s.pag2_5},
                                    {"_pag7.5", s.pag7_5},
                                    {"_completeness", s.completeness},
                                    {"_pag1_compared", s.pag1_compared},
                                    {"_pag2.5_compared", s.pag2_5_compared},
                                    {"_pag7.5_compared", s.pag7_5_compared},
                                    {"_truth_cells", static_cast<double>(s.truth)},
                                    {"_compared_cells", static_cast<double>(s.compared)}})
    row.push_back({group + name, value});
}

mesh::SurfaceScores none_compared() {
  constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
  mesh::SurfaceScores out{.chamfer = kNone, .to_reference = kNone, .to_mesh = kNone, .f = {}};
  for (mesh::FScore& f : out.f) f.precision = f.recall = f.f1 = kNone;
  return out;
}

void add_mesh(Row& row, const std::string& group, const mesh::SurfaceScores& s) {
  row.push_back({group + "_chamfer", s.chamfer});
  row.push_back({group + "_to_reference", s.to_reference});
  row.push_back({group + "_reference_to_mesh", s.to_mesh});
  for (const auto& [name, f] : {std::pair<const char*, const mesh::FScore&>{"_f1_0.5", s.f[0]},
                                {"_f1_1", s.f[1]},
                                {"_f1_2.5", s.f[2]}})
    row.push_back({group + name, f.f1});
}

/// Names and values of the numbers that go into tables.
Row row_of(const SceneScores& s) {
  Row row;
  add_heights(row, "dsm", s.dsm.registered);
  add_heights(row, "mvs_source", s.mvs_source);
  add_heights(row, "render_target", s.render_target);
  for (std::size_t k = 0; k < kRegistrations.size(); ++k) {
    const std::string group = std::string("dsm_") + kRegistrations[k];
    add_heights(row, group, s.registered[k].scores);
    row.push_back({group + "_east", s.registered[k].shift[0]});
    row.push_back({group + "_north", s.registered[k].shift[1]});
    row.push_back({group + "_up", s.registered[k].shift[2]});
  }
  for (std::size_t k = 0; k < kRegistrations.size(); ++k)
    add_heights(row, std::string("dsm_filled_") + kRegistrations[k], s.registered[k].filled);
  add_mesh(row, "mesh", s.mesh ? s.mesh->all : none_compared());
  add_mesh(row, "mesh_without_walls", s.mesh ? s.mesh->without_walls : none_compared());
  row.push_back({"mvs_source_rmse_per_view", s.mvs_source_rmse_per_view});
  row.push_back({"render_target_psnr", s.target.psnr});
  row.push_back({"render_target_psnr_fitted", s.target.psnr_fitted});
  row.push_back({"render_target_ssim", s.target.ssim});
  row.push_back({"render_target_ssim_conv", s.target.ssim_conv});
  row.push_back({"render_target_lpips", s.target.lpips.value_or(std::nan(""))});
  row.push_back({"render_target_covered", s.target_covered});
  row.push_back({"seconds", s.seconds});
  return row;
}

/// Each number on average over the scenes for which it exists, else NaN.
struct Mean {
  Row row;
  std::vector<std::size_t> scenes;  ///< how many these are, number by number
};
Mean mean_of(const std::vector<SceneScores>& scores) {
  Mean mean;
  for (const SceneScores& s : scores) {
    const Row row = row_of(s);
    if (mean.row.empty()) {
      for (const auto& [name, value] : row) mean.row.push_back({name, 0});
      mean.scenes.resize(row.size());
    }
    for (std::size_t k = 0; k < row.size(); ++k)
      if (std::isfinite(row[k].second)) mean.row[k].second += row[k].second, mean.scenes[k] += 1;
  }
  for (std::size_t k = 0; k < mean.row.size(); ++k) {
    double& value = mean.row[k].second;
    value = mean.scenes[k] > 0 ? value / static_cast<double>(mean.scenes[k]) : std::nan("");
  }
  return mean;
}

/// A cell of CSV, in quotes where it has to be.
std::string csv_cell(const std::string& text) {
  if (text.find_first_of(",\"\r\n") == std::string::npos) return text;
  std::string out = "\"";
  for (const char c : text) out += c == '"' ? std::string("\"\"") : std::string(1, c);
  return out + "\"";
}

nlohmann::ordered_json by_registration(const SceneScores& s) {
  nlohmann::ordered_json out;
  for (std::size_t k = 0; k < kRegistrations.size(); ++k)
    out[kRegistrations[k]] = {{"shift_m", s.registered[k].shift},
                              {"scores", scores_json(s.registered[k].scores)},
                              {"holes_filled", scores_json(s.registered[k].filled)}};
  return out;
}

}  // namespace

nlohmann::ordered_json scores_json(const HeightScores& s) {
  return {{"truth_cells", s.truth},
          {"compared_cells", s.compared},
          {"completeness", json_number(s.completeness)},
          {"mae", json_number(s.mae)},
          {"rmse", json_number(s.rmse)},
          {"median", json_number(s.median)},
          {"nmad", json_number(s.nmad)},
          {"pag1", json_number(s.pag1)},
          {"pag2.5", json_number(s.pag2_5)},
          {"pag7.5", json_number(s.pag7_5)},
          {"pag1_compared", json_number(s.pag1_compared)},
          {"pag2.5_compared", json_number(s.pag2_5_compared)},
          {"pag7.5_compared", json_number(s.pag7_5_compared)}};
}

nlohmann::ordered_json scores_json(const mesh::MeshComparison& c) {
  const auto of = [](const mesh::SurfaceScores& s) {
    nlohmann::ordered_json j{{"chamfer", json_number(s.chamfer)},
                             {"mesh_to_reference", json_number(s.to_reference)},
                             {"reference_to_mesh", json_number(s.to_mesh)},
                             {"f1", nlohmann::ordered_json::object()},
                             {"precision", nlohmann::ordered_json::object()},
                             {"recall", nlohmann::ordered_json::object()},
                             {"mesh_samples", s.mesh_samples},
                             {"reference_samples", s.reference_samples}};
    for (const mesh::FScore& f : s.f) {
      char key[16];
      std::snprintf(key, sizeof key, "%g", f.threshold);
      j["f1"][key] = json_number(f.f1);
      j["precision"][key] = json_number(f.precision);
      j["recall"][key] = json_number(f.recall);
    }
    return j;
  };
  nlohmann::ordered_json j = of(c.all);
  j["without_walls"] = of(c.without_walls);
  return j;
}

nlohmann::ordered_json scores_json(const DsmComparison& c) {
  return {
      {"raw", scores_json(c.raw)}, {"registered", scores_json(c.registered)}, {"shift_m", c.shift}};
}

nlohmann::ordered_json scores_json(const std::vector<SceneScores>& scores) {
  nlohmann::ordered_json out{{"scenes", nlohmann::ordered_json::array()},
                             {"mean", nlohmann::ordered_json::object()},
                             {"mean_scenes", nlohmann::ordered_json::object()},
                             {"lpips_backbone", nullptr}};
  for (const SceneScores& s : scores) {
    out["scenes"].push_back(
        {{"name", s.name},
         {"dsm", scores_json(s.dsm)},
         {"dsm_by_registration", by_registration(s)},
         {"mvs_source", scores_json(s.mvs_source)},
         {"mvs_source_rmse_per_view", json_number(s.mvs_source_rmse_per_view)},
         {"render_target", scores_json(s.render_target)},
         {"mesh", s.mesh ? scores_json(*s.mesh) : nlohmann::ordered_json(nullptr)},
         {"render_target_psnr", json_number(s.target.psnr)},
         {"render_target_psnr_fitted", json_number(s.target.psnr_fitted)},
         {"render_target_ssim", json_number(s.target.ssim)},
         {"render_target_ssim_conv", json_number(s.target.ssim_conv)},
         {"render_target_lpips", json_number(s.target.lpips.value_or(std::nan("")))},
         {"render_target_covered", json_number(s.target_covered)},
         {"seconds", s.seconds}});
    if (!s.target.lpips_backbone.empty()) out["lpips_backbone"] = s.target.lpips_backbone;
  }
  const Mean mean = mean_of(scores);
  for (std::size_t k = 0; k < mean.row.size(); ++k) {
    const auto& [name, value] = mean.row[k];
    out["mean"][name] = json_number(value);
    if (mean.scenes[k] < scores.size()) out["mean_scenes"][name] = mean.scenes[k];
  }
  return out;
}

nlohmann::ordered_json scores_json(const DataScores& scores) {
  nlohmann::ordered_json out = scores_json(scores.scenes);
  out["confidence"] = {{"mvs_source", confidence_json(scores.confidence.mvs_source)},
                       {"dsm", confidence_json(scores.confidence.dsm)}};
  return out;
}

std::string scores_csv(const std::vector<SceneScores>& scores) {
  if (scores.empty()) return {};
  std::string text = "scene";
  for (const auto& [name, value] : row_of(scores[0])) text += "," + name;
  text += "\n";
  const auto add = [&text](const std::string& name, const Row& row) {
    text += csv_cell(name);
    for (const auto& [column, value] : row) {
      char cell[32];
      std::snprintf(cell, sizeof cell, ",%.8g", value);
      text += std::isfinite(value) ? cell : ",";
    }
    text += "\n";
  };
  for (const SceneScores& s : scores) add(s.name, row_of(s));
  add("mean", mean_of(scores).row);
  return text;
}

}  // namespace satsurf::train

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/evaluate/table.h"

#include <array>
#include <cmath>
#include <cstdio>
#include <limits>
#include <utility>

namespace satsurf::evaluate {
namespace {

constexpr std::array kNames = EnumNames<Registration>::names;

void add_heights(TableRow& row, const std::string& group, const HeightScores& s) {
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

void add_mesh(TableRow& row, const std::string& group, const mesh::SurfaceScores& s) {
  row.push_back({group + "_chamfer", s.chamfer});
  row.push_back({group + "_to_reference", s.to_reference});
  row.push_back({group + "_reference_to_mesh", s.to_mesh});
  for (const auto& [name, f] : {std::pair<const char*, const mesh::FScore&>{"_f1_0.5", s.f[0]},
                                {"_f1_1", s.f[1]},
                                {"_f1_2.5", s.f[2]}})
    row.push_back({group + name, f.f1});
}

constexpr std::array kCauseNames = EnumNames<Cause>::names;

void add_causes(TableRow& row, const CauseScores& causes) {
  for (std::size_t k = 0; k < kCauses; ++k) {
    const std::string group = std::string("cause_") + kCauseNames[k];
    const CauseScore& s = causes[k];
    for (const auto& [name, value] : {std::pair<const char*, double>{"_cells", s.cells},
                                      {"_share", s.share},
                                      {"_mae", s.mae},
                                      {"_median", s.median},
                                      {"_pag2.5", s.pag2_5},
                                      {"_error_share", s.error_share}})
      row.push_back({group + name, value});
  }
}

/// A cell of CSV, in quotes where it has to be.
std::string csv_cell(const std::string& text) {
  if (text.find_first_of(",\"\r\n") == std::string::npos) return text;
  std::string out = "\"";
  for (const char c : text) out += c == '"' ? std::string("\"\"") : std::string(1, c);
  return out + "\"";
}

}  // namespace

TableRow row_of(const SceneScores& s) {
  TableRow row;
  add_heights(row, "dsm", s.dsm.registered);
  add_heights(row, "mvs_source", s.mvs_source);
  add_heights(row, "render_target", s.render_target);
  for (std::size_t k = 0; k < kNames.size(); ++k) {
    const std::string group = std::string("dsm_") + kNames[k];
    add_heights(row, group, s.registered[k].scores);
    row.push_back({group + "_east", s.registered[k].shift[0]});
    row.push_back({group + "_north", s.registered[k].shift[1]});
    row.push_back({group + "_up", s.registered[k].shift[2]});
  }
  for (std::size_t k = 0; k < kNames.size(); ++k)
    add_heights(row, std::string("dsm_filled_") + kNames[k], s.registered[k].filled);
  add_mesh(row, "mesh", s.mesh ? s.mesh->all : none_compared());
  add_mesh(row, "mesh_without_walls", s.mesh ? s.mesh->without_walls : none_compared());
  add_causes(row, s.causes);
  row.push_back({"sigma_within_1", s.sigma.within_1});
  row.push_back({"sigma_within_2", s.sigma.within_2});
  row.push_back({"oracle_share", s.oracle.share});
  row.push_back({"oracle_mae", s.oracle.mae});
  row.push_back({"lost_stage1", s.lost[0]});
  row.push_back({"lost_stage2", s.lost[1]});
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

const std::vector<std::pair<std::string, std::string>>& table_groups() {
  static const std::vector<std::pair<std::string, std::string>> groups{
      {"dsm", "the reconstructed surface after what --register takes out"},
      {"mvs_source", "the network's last heights in the source views, all pixels pooled"},
      {"render_target",
       "heights and colours that the reconstructed surfels show in the scene's next view; the "
       "colours of the pixels that the surface covers"},
      {"dsm_none", "the surface as it is"},
      {"dsm_z", "the surface after a height offset is taken out"},
      {"dsm_xyz", "the surface after a shift in all axes is taken out"},
      {"dsm_filled_none",
       "dsm_none, then each hole filled from the nearest known cell of each quadrant, weighed by 1 "
       "/ distance²"},
      {"dsm_filled_z", "dsm_z, filled likewise"},
      {"dsm_filled_xyz", "dsm_xyz, filled likewise"},
      {"mesh",
       "a mesh of the heights that the surfels show in all views, against that of the truth; none "
       "with --no-meshes"},
      {"mesh_without_walls", "the same without the parts of either that are steep"},
      {"cause_hidden",
       "the filled surface after what --register takes out, as in all groups of causes; cells "
       "whose true point one of the source views that contain it does not see"},
      {"cause_seen_by_one", "cells whose true point no more than one of them sees"},
      {"cause_shadow",
       "cells in cast shadow in one of them; none if no view says where the sun stood"},
      {"cause_roof_small",
       "buildings below 400 m², more than two cells from their rim; like all groups by class none "
       "without a class raster"},
      {"cause_roof_medium", "the same of buildings of 400 to 2000 m²"},
      {"cause_roof_large", "the same of buildings above 2000 m²"},
      {"cause_rim",
       "the two cells on either side of a step of more than 2 m between neighbours of the truth"},
      {"cause_tree", "cells of class 5"},
      {"cause_open_ground", "cells of class 2 that are neither hidden nor in shadow nor at a rim"},
      {"cause_water", "cells of class 9, with --keep-water"},
      {"cause_other", "cells in none of the groups of causes before"},
      {"sigma",
       "the expected errors of a refined surface, against its errors after what --register takes "
       "out"},
      {"oracle",
       "the height nearest to the truth of all surfels whose centre lies in a cell, for the share "
       "of cells that have one, then filled: no choice among surfels does better where they lie"},
      {"lost",
       "pixels of the source views with known truth: the share that the search can no longer "
       "find"}};
  return groups;
}

std::vector<TableColumn> table_columns() {
  struct Number {
    const char *name, *unit, *meaning;
  };
  static constexpr std::array kNumbers{
      Number{"mae", "m", "mean absolute error"},
      Number{"rmse", "m", "root of the mean square error"},
      Number{"median", "m", "median of the signed errors, prediction minus truth"},
      Number{"nmad", "m", "1.4826 times the median deviation from that median"},
      Number{"pag1", "share", "true cells with an error below 1 m; a hole is a failure"},
      Number{"pag2.5", "share", "true cells with an error below 2.5 m"},
      Number{"pag7.5", "share", "true cells with an error below 7.5 m"},
      Number{"completeness", "share", "true cells that have a predicted height"},
      Number{"pag1_compared", "share", "cells found with an error below 1 m"},
      Number{"pag2.5_compared", "share", "cells found with an error below 2.5 m"},
      Number{"pag7.5_compared", "share", "cells found with an error below 7.5 m"},
      Number{"truth_cells", "cells", "cells or pixels with a true height that count"},
      Number{"compared_cells", "cells", "those of them that have a predicted height"},
      Number{"east", "m", "shift that was added to the prediction, eastwards"},
      Number{"north", "m", "shift that was added, northwards"},
      Number{"up", "m", "shift that was added, upwards"},
      Number{"cells", "cells", "cells that count and belong to the group"},
      Number{"share", "share", "those of all cells that count"},
      Number{
          "error_share", "share",
          "what they carry of the sum of all absolute errors; cells may belong to several groups"},
      Number{"within_1", "share", "cells whose error is within the expected one: 0.68 is right"},
      Number{"within_2", "share", "cells whose error is within twice that: 0.95 is right"},
      Number{"stage1", "share",
             "whose true height lies outside the window that the stage after the first covers"},
      Number{"stage2", "share", "the same of the last stage"},
      Number{"chamfer", "m", "mean of the two distances that follow"},
      Number{"to_reference", "m", "mean distance of the mesh from the reference"},
      Number{"reference_to_mesh", "m", "mean distance of the reference from the mesh"},
      Number{"f1_0.5", "share", "F1 within 0.5 m: harmonic mean of precision and recall"},
      Number{"f1_1", "share", "F1 within 1 m"},
      Number{"f1_2.5", "share", "F1 within 2.5 m"},
      Number{"rmse_per_view", "m", "root of the mean square error view by view, then averaged"},
      Number{"psnr", "dB", "peak signal-to-noise ratio"},
      Number{"psnr_fitted", "dB", "the same after the best affine map of the colours"},
      Number{"ssim", "", "structural similarity as scikit-image has it"},
      Number{"ssim_conv", "", "structural similarity as the training loss has it"},
      Number{"lpips", "", "perceptual distance; none without --lpips-weights"},
      Number{"covered", "share", "valid pixels that the surface covers"},
      Number{"seconds", "s", "time of the reconstruction without reading files"}};
  std::vector<TableColumn> columns;
  for (const auto& [name, value] : row_of({})) {
    TableColumn column{name, "", name, "", ""};
    for (const auto& [group, meaning] : table_groups())
      if (name.starts_with(group + "_") && group.size() > column.group.size())
        column.group = group, column.number = name.substr(group.size() + 1);
    for (const Number& number : kNumbers)
      if (column.number == number.name) column.unit = number.unit, column.meaning = number.meaning;
    columns.push_back(column);
  }
  return columns;
}

TableMean mean_of(const std::vector<SceneScores>& scores) {
  TableMean mean;
  for (const SceneScores& s : scores) {
    const TableRow row = row_of(s);
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

std::string scores_csv(const std::vector<SceneScores>& scores) {
  if (scores.empty()) return {};
  std::string text = "scene";
  for (const auto& [name, value] : row_of(scores[0])) text += "," + name;
  text += "\n";
  const auto add = [&text](const std::string& name, const TableRow& row) {
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

}  // namespace satsurf::evaluate

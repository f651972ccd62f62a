// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/scores_json.h"

#include "satsurf/app/record.h"
#include "satsurf/evaluate/table.h"

#include <cmath>
#include <string>

#include <fmt/format.h>

namespace satsurf::app {
namespace {

nlohmann::ordered_json bins_json(const std::vector<evaluate::ConfidenceBin>& bins) {
  auto out = nlohmann::ordered_json::array();
  for (const evaluate::ConfidenceBin& b : bins)
    out.push_back({{"low", b.low},
                   {"high", b.high},
                   {"confidence", json_number(b.confidence)},
                   {"pixels", b.pixels},
                   {"mae", json_number(b.mae)},
                   {"rmse", json_number(b.rmse)},
                   {"pag1", json_number(b.pag1)},
                   {"pag2.5", json_number(b.pag2_5)},
                   {"pag7.5", json_number(b.pag7_5)}});
  return out;
}

nlohmann::ordered_json by_registration(const evaluate::SceneScores& s) {
  nlohmann::ordered_json out;
  const auto& names = EnumNames<evaluate::Registration>::names;
  for (std::size_t k = 0; k < names.size(); ++k)
    out[names[k]] = {{"shift_m", s.registered[k].shift},
                     {"scores", scores_json(s.registered[k].scores)},
                     {"holes_filled", scores_json(s.registered[k].filled)}};
  return out;
}

/// Of the causes that are known of a scene.
nlohmann::ordered_json causes_json(const evaluate::CauseScores& causes) {
  auto out = nlohmann::ordered_json::object();
  for (std::size_t k = 0; k < causes.size(); ++k) {
    const evaluate::CauseScore& c = causes[k];
    if (std::isnan(c.cells)) continue;
    out[EnumNames<evaluate::Cause>::names[k]] = {{"cells", c.cells},
                                                 {"share", json_number(c.share)},
                                                 {"mae", json_number(c.mae)},
                                                 {"median", json_number(c.median)},
                                                 {"pag2.5", json_number(c.pag2_5)},
                                                 {"error_share", json_number(c.error_share)}};
  }
  return out;
}

}  // namespace

nlohmann::ordered_json scores_json(const evaluate::HeightScores& s) {
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
      const std::string key = fmt::format("{:g}", f.threshold);
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

nlohmann::ordered_json scores_json(const evaluate::DsmComparison& c) {
  return {{"raw", scores_json(c.raw)},
          {"registered", scores_json(c.registered)},
          {"shift_m", c.shift},
          {"refused_shift_m",
           c.refused_shift ? nlohmann::ordered_json(*c.refused_shift) : nlohmann::ordered_json()}};
}

nlohmann::ordered_json scores_json(const std::vector<evaluate::SceneScores>& scores) {
  nlohmann::ordered_json out{{"scenes", nlohmann::ordered_json::array()},
                             {"mean", nlohmann::ordered_json::object()},
                             {"mean_scenes", nlohmann::ordered_json::object()},
                             {"lpips_backbone", nullptr}};
  for (const evaluate::SceneScores& s : scores) {
    out["scenes"].push_back(
        {{"name", s.name},
         {"dsm", scores_json(s.dsm)},
         {"dsm_by_registration", by_registration(s)},
         {"causes", causes_json(s.causes)},
         {"sigma",
          {{"within_1", json_number(s.sigma.within_1)},
           {"within_2", json_number(s.sigma.within_2)}}},
         {"oracle", {{"share", json_number(s.oracle.share)}, {"mae", json_number(s.oracle.mae)}}},
         {"lost", {{"stage1", json_number(s.lost[0])}, {"stage2", json_number(s.lost[1])}}},
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
  const evaluate::TableMean mean = evaluate::mean_of(scores);
  for (std::size_t k = 0; k < mean.row.size(); ++k) {
    const auto& [name, value] = mean.row[k];
    out["mean"][name] = json_number(value);
    if (mean.scenes[k] < scores.size()) out["mean_scenes"][name] = mean.scenes[k];
  }
  return out;
}

nlohmann::ordered_json scores_json(const evaluate::DataScores& scores) {
  nlohmann::ordered_json out = scores_json(scores.scenes);
  out["confidence"] = {{"mvs_source", confidence_json(scores.confidence.mvs_source)},
                       {"dsm", confidence_json(scores.confidence.dsm)}};
  return out;
}

nlohmann::ordered_json confidence_json(const evaluate::ConfidenceErrors& errors) {
  return {{"pixels", errors.pixels()},
          {"equal_width", bins_json(errors.equal_width())},
          {"equal_count", bins_json(errors.equal_count())},
          {"monotone", errors.monotone()}};
}

}  // namespace satsurf::app

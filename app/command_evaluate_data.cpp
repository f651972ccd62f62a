// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/confidence_figure.h"
#include "satsurf/app/evaluate_options.h"
#include "satsurf/app/interrupt.h"
#include "satsurf/app/output_folder.h"
#include "satsurf/app/progress.h"
#include "satsurf/app/record.h"
#include "satsurf/app/scores_json.h"
#include "satsurf/core/atomic_file.h"
#include "satsurf/core/fields_json.h"
#include "satsurf/evaluate/evaluate.h"
#include "satsurf/evaluate/table.h"
#include "satsurf/nn/shipped_weights.h"
#include "satsurf/nn/weights_file.h"

#include <cmath>
#include <cstdio>
#include <map>
#include <optional>
#include <set>
#include <utility>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

namespace satsurf::app {
namespace {

namespace fs = std::filesystem;

/// A number that fills `width` characters, or a dash for one that does not exist.
std::string cell(int width, int decimals, double v, const char* unit = "") {
  if (std::isfinite(v)) return fmt::format(" {:{}.{}f}{}", v, width, decimals, unit);
  return fmt::format(" {:>{}}{}", "-", width, unit[0] != '\0' ? " " : "");
}

std::string heights_cells(double mae, double rmse, double pag1, double pag2_5, double pag7_5,
                          double completeness) {
  std::string text = cell(9, 3, mae) + cell(9, 3, rmse);
  for (const double share : {pag1, pag2_5, pag7_5, completeness})
    text += cell(8, 1, 100 * share, "%");
  return text;
}

constexpr const char* kHeightsHead = "     MAE m    RMSE m      <1 m    <2.5 m    <7.5 m  complete";

void print_scenes(const std::vector<evaluate::SceneScores>& scores) {
  std::printf("%-16s%s  source m   PSNR dB      SSIM     LPIPS\n", "scene", kHeightsHead);
  for (const evaluate::SceneScores& s : scores) {
    const evaluate::HeightScores& d = s.dsm.registered;
    std::printf("%-16s%s%s%s%s%s\n", s.name.c_str(),
                heights_cells(d.mae, d.rmse, d.pag1, d.pag2_5, d.pag7_5, d.completeness).c_str(),
                cell(9, 3, s.mvs_source.mae).c_str(), cell(9, 2, s.target.psnr).c_str(),
                cell(9, 4, s.target.ssim).c_str(),
                cell(9, 4, s.target.lpips.value_or(std::nan(""))).c_str());
  }
}

/// The means of `scores_json` by name. Remembers which were asked for.
class Means {
 public:
  explicit Means(const nlohmann::ordered_json& table) : table_(table) {}
  /// NaN for a number that no scene has.
  double of(const std::string& name) {
    asked_.insert(name);
    const auto& mean = table_["mean"][name];
    return mean.is_null() ? std::nan("") : mean.get<double>();
  }
  /// Names those that some scenes have no part in, for a failure may be the reason.
  void print_fewer() const {
    std::map<Index, std::string> names;
    for (const auto& [name, scenes] : table_["mean_scenes"].items())
      if (scenes > 0 && asked_.contains(name)) names[scenes.get<Index>()] += " " + name;
    for (const auto& [scenes, list] : names)
      std::printf("mean of %td of %zu scenes:%s\n", scenes, table_["scenes"].size(), list.c_str());
  }

 private:
  const nlohmann::ordered_json& table_;
  std::set<std::string> asked_;
};

void print_mean(Means& mean, const std::string& registration) {
  const auto row = [&](const std::string& group) {
    return heights_cells(mean.of(group + "_mae"), mean.of(group + "_rmse"),
                         mean.of(group + "_pag1"), mean.of(group + "_pag2.5"),
                         mean.of(group + "_pag7.5"), mean.of(group + "_completeness"));
  };
  std::printf("%-16s%s%s%s%s%s\n", "mean", row("dsm").c_str(),
              cell(9, 3, mean.of("mvs_source_mae")).c_str(),
              cell(9, 2, mean.of("render_target_psnr")).c_str(),
              cell(9, 4, mean.of("render_target_ssim")).c_str(),
              cell(9, 4, mean.of("render_target_lpips")).c_str());
  std::printf("\n%-16s%s\n", "mean", kHeightsHead);
  for (const auto& [title, group] : {std::pair<const char*, std::string>{"DSM", "dsm"},
                                     {"DSM, filled", "dsm_filled_" + registration},
                                     {"source views", "mvs_source"},
                                     {"target view", "render_target"}})
    std::printf("%-16s%s\n", title, row(group).c_str());
  if (const double covered = mean.of("render_target_covered"); std::isfinite(covered))
    std::printf("%-16s colours scored on %.1f%% of the valid pixels, where surfels cover them\n",
                "target view", 100 * covered);
}

void print_meshes(Means& mean) {
  for (const auto& [title, group] : {std::pair<const char*, std::string>{"mesh", "mesh"},
                                     {"mesh, no walls", "mesh_without_walls"}}) {
    const double chamfer = mean.of(group + "_chamfer");
    if (!std::isfinite(chamfer)) return;
    std::printf("%-16s chamfer %.3f m, F1 %.3f within 0.5 m, %.3f within 1 m, %.3f within 2.5 m\n",
                title, chamfer, mean.of(group + "_f1_0.5"), mean.of(group + "_f1_1"),
                mean.of(group + "_f1_2.5"));
  }
}

/// Where the error is: means over the scenes that have such cells, without rows that none has.
void print_causes(const nlohmann::ordered_json& table) {
  const auto mean = [&](const std::string& name) {
    const auto& value = table["mean"][name];
    return value.is_null() ? std::nan("") : value.get<double>();
  };
  const std::size_t all = table["scenes"].size();
  const auto scenes = [&](const std::string& name) {
    return table["mean_scenes"].value(name, all);
  };
  std::printf("\n%-16s%9s%12s%12s%10s%10s%8s\n", "DSM, filled", "cells", "MAE m", "median m",
              "<2.5 m", "of error", "scenes");
  for (const char* name : EnumNames<evaluate::Cause>::names) {
    const std::string group = std::string("cause_") + name;
    if (!(mean(group + "_cells") > 0)) continue;
    std::printf(
        "%-16s%s  %s  %s%s%s%8zu\n", name, cell(8, 1, 100 * mean(group + "_share"), "%").c_str(),
        cell(9, 3, mean(group + "_mae")).c_str(), cell(9, 3, mean(group + "_median")).c_str(),
        cell(8, 1, 100 * mean(group + "_pag2.5"), "%").c_str(),
        cell(8, 1, 100 * mean(group + "_error_share"), "%").c_str(), scenes(group + "_mae"));
  }
  std::printf("%-16s%s  %s\n", "oracle", cell(8, 1, 100 * mean("oracle_share"), "%").c_str(),
              cell(9, 3, mean("oracle_mae")).c_str());
  std::printf("lost pixels     %s by stage 1, %s by stage 2\n",
              cell(8, 2, 100 * mean("lost_stage1"), "%").c_str(),
              cell(1, 2, 100 * mean("lost_stage2"), "%").c_str());
  if (std::isfinite(mean("sigma_within_1")))
    std::printf("expected errors %s of the cells within one, %s within two\n",
                cell(8, 1, 100 * mean("sigma_within_1"), "%").c_str(),
                cell(1, 1, 100 * mean("sigma_within_2"), "%").c_str());
}

/// How the error depends on the confidence, in a line.
void print_confidence(const char* title, const evaluate::ConfidenceErrors& errors) {
  const std::vector<evaluate::ConfidenceBin> bins = errors.equal_count();
  if (bins.empty()) return;
  std::printf("%-16s MAE %.3f m at confidence %.2f, %.3f m at %.2f; %s\n", title, bins.front().mae,
              bins.front().confidence, bins.back().mae, bins.back().confidence,
              bins.size() < evaluate::ConfidenceErrors::kFewest
                  ? "too few bins to tell whether it falls"
              : errors.monotone() ? "it always falls with confidence"
                                  : "it does not always fall with confidence");
}

}  // namespace

void run_evaluate_data(const EvaluateDataCommand& options, const EvaluateOutput& output) {
  const fs::path weights =
      options.weights.empty()
          ? nn::shipped_weights(nn::ShippedNetwork::cascade, "give --weights FILE")
          : options.weights;
  std::vector<fs::path> inputs{weights, options.data};
  if (!options.lpips_weights.empty()) inputs.push_back(options.lpips_weights);
  check_output_file("--json", output.json, output.overwrite, inputs);
  check_output_file("--csv", options.csv, output.overwrite, inputs);
  check_output_file("--confidence-csv", options.confidence_csv, output.overwrite, inputs);
  check_output_file("--confidence-figure", options.confidence_figure, output.overwrite, inputs);
  check_distinct({options.csv, output.json, options.confidence_csv, options.confidence_figure});
  const TensorFile networks = load_safetensors(weights);
  const nn::Model model = nn::model_from(networks, weights.string());
  const std::optional<nn::SurfaceModel> network = nn::surface_from(networks, weights.string());
  std::optional<nn::Lpips> lpips;
  if (!options.lpips_weights.empty()) lpips.emplace(nn::Lpips::load(options.lpips_weights));
  Progress progress;
  evaluate::EvaluateOptions how;
  how.views = options.views;
  how.registration = options.registration;
  how.surface = options.surface;
  how.network = network ? &*network : nullptr;
  how.window = options.window;
  how.range_above = options.range_above;
  how.mask_water = options.mask_water;
  how.meshes = options.meshes;
  how.lpips = lpips ? &*lpips : nullptr;
  how.progress = [&](const std::string& stage, double fraction) {
    stop_if_interrupted();
    progress.update(stage, fraction);
  };
  EvaluateDataConfig config = options;
  config.weights = weights;
  RunRecord record("evaluate", recorded_config(config), 0);
  const evaluate::DataScores scores = [&] {
    const EndsAtSignal stops;
    return evaluate::evaluate_data(model, options.data, how);
  }();
  const nlohmann::ordered_json table = scores_json(scores);
  const std::vector<evaluate::NamedConfidence> confidence{
      {"mvs_source", "Source views", &scores.confidence.mvs_source},
      {"dsm", "DSM", &scores.confidence.dsm}};

  // before any file is written: a full disk must not cost the result
  print_scenes(scores.scenes);
  Means mean(table);
  print_mean(mean, enum_name(options.registration));
  print_meshes(mean);
  mean.print_fewer();
  print_causes(table);
  if (lpips)
    std::printf("LPIPS by %s\n", nn::lpips_backbone_name(lpips->backbone()));
  else
    std::printf("no LPIPS: no --lpips-weights given\n");
  for (const evaluate::NamedConfidence& c : confidence)
    print_confidence(c.title.c_str(), *c.errors);
  std::fflush(stdout);

  if (!output.json.empty()) {
    for (const fs::path& input : inputs) record.add_input(input);
    record.results() = table;
    record.save(output.json);
  }
  if (!options.csv.empty()) atomic_write(options.csv, evaluate::scores_csv(scores.scenes));
  if (!options.confidence_csv.empty())
    atomic_write(options.confidence_csv, evaluate::confidence_csv(confidence));
  if (!options.confidence_figure.empty())
    atomic_write(options.confidence_figure, confidence_svg(confidence));
}

}  // namespace satsurf::app

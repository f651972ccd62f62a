// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/config.h"

#include <algorithm>
#include <array>
#include <numeric>
#include <utility>

namespace satsurf::nn {

namespace {

ModelConfig base8() { return {}; }

ModelConfig base16() { return {.base = 16, .volume_base = 16, .head_width = {96, 64, 48}}; }

ModelConfig wide8() {
  ModelConfig config = base8();
  config.best_pair = true;
  config.feature_levels = 2;
  config.local_contrast = true;
  config.height = HeightOf::mode;
  config.centre = Centre::nearest;
  return config;
}

ModelConfig tiny_full() {
  return {.base = 4,
          .hypotheses = {8, 8, 4},
          .most_hypotheses = 8,
          .volume_base = 4,
          .volume_levels = 2,
          .head_width = {8, 8, 8},
          .mono_net = {.base = 2}};
}

/// Matching alone: no monocular branch, and no stage tells the next more than where to search.
ModelConfig matching_alone(ModelConfig config) {
  config.mono = MonoBranch::none;
  config.fusion = Fusion::none;
  config.guidance = Guidance::none;
  config.context = Context::none;
  return config;
}

ModelConfig tiny() { return matching_alone(tiny_full()); }
ModelConfig cascade8() { return matching_alone(base8()); }

ModelConfig paper() {
  return {.most_hypotheses = 64,
          .context = Context::none,
          .rotation = Rotation::camera,
          .fusion_start = FusionStart::paper,
          .confidence = Confidence::raw};
}

ModelConfig mvsplat_like() {
  return matching_alone({.hypotheses = {128, 0, 0}, .most_hypotheses = 128});
}

ModelConfig hisplat_like() {
  ModelConfig config = matching_alone({.most_hypotheses = 64, .keep = Keep::all});
  config.guidance = Guidance::photometric;
  return config;
}

ModelConfig skysplat_like() {
  return {.hypotheses = {64, 0, 0},
          .most_hypotheses = 64,
          .context = Context::none,
          .rotation = Rotation::camera,
          .fusion = Fusion::none,
          .guidance = Guidance::none};
}

constexpr std::array<std::pair<const char*, ModelConfig (*)()>, 10> kPresets{
    {{"tiny", tiny},
     {"tiny_full", tiny_full},
     {"base8", base8},
     {"base16", base16},
     {"wide8", wide8},
     {"cascade8", cascade8},
     {"paper", paper},
     {"mvsplat_like", mvsplat_like},
     {"hisplat_like", hisplat_like},
     {"skysplat_like", skysplat_like}}};

}  // namespace

ModelConfig model_preset(const std::string& name) {
  for (const auto& [known, config] : kPresets)
    if (name == known) return config();
  detail::refuse_choice(name, model_preset_names(), "preset");
}

std::vector<std::string> model_preset_names() {
  std::vector<std::string> names;
  for (const auto& [name, config] : kPresets) names.emplace_back(name);
  return names;
}

Index size_multiple(const ModelConfig& config) {
  return std::lcm(Index{4} << std::max(config.volume_levels, config.feature_levels),
                  config.mono == MonoBranch::none ? 1 : kMonoMultiple);
}

}  // namespace satsurf::nn

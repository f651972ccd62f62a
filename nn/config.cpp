// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/config.h"

#include <numeric>

namespace satsurf::nn {

namespace {

/// Matching alone: no monocular branch, and no stage tells the next more than where to search.
ModelConfig cascade(ModelConfig config) {
  config.mono = config.fusion = config.guidance = config.context = "none";
  return config;
}

ModelConfig tiny() {
  return {.base = 4,
          .hypotheses = {8, 8, 4},
          .volume_base = 4,
          .volume_levels = 2,
          .head_width = {8, 8, 8},
          .mono_net = {.base = 2}};
}

}  // namespace

ModelConfig model_preset(const std::string& name) {
  if (name == "tiny") return cascade(tiny());
  if (name == "tiny_full") return tiny();
  if (name == "base8") return {};
  if (name == "base16") return {.base = 16, .volume_base = 16, .head_width = {96, 64, 48}};
  if (name == "cascade8") return cascade({});
  if (name == "paper")
    return {.context = "none", .rotation = "camera", .fusion_start = "paper", .confidence = "raw"};
  if (name == "mvsplat_like") return cascade({.hypotheses = {128, 0, 0}});
  if (name == "hisplat_like") {
    ModelConfig config = cascade({.keep = "all"});
    config.guidance = "photometric";
    return config;
  }
  if (name == "skysplat_like")
    return {.hypotheses = {64, 0, 0},
            .context = "none",
            .rotation = "camera",
            .fusion = "none",
            .guidance = "none"};
  throw ConfigError("preset: '" + name + "', expected one of " + model_preset_names());
}

std::string model_preset_names() {
  return "tiny, tiny_full, base8, base16, cascade8, paper, mvsplat_like, hisplat_like, "
         "skysplat_like";
}

Index size_multiple(const ModelConfig& config) {
  return std::lcm(Index{4} << config.volume_levels, config.mono == "none" ? 1 : kMonoMultiple);
}

}  // namespace satsurf::nn

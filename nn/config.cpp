// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/config.h"

namespace satsurf::nn {

ModelConfig model_preset(const std::string& name) {
  if (name == "tiny")
    return {.base = 4,
            .hypotheses = {8, 8, 4},
            .volume_base = 4,
            .volume_levels = 2,
            .head_width = {8, 8, 8}};
  if (name == "base8") return {};
  if (name == "base16") return {.base = 16, .volume_base = 16, .head_width = {96, 64, 48}};
  throw ConfigError("preset: '" + name + "', expected tiny, base8 or base16");
}

Index size_multiple(const ModelConfig& config) { return Index{4} << config.volume_levels; }

}  // namespace satsurf::nn

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/fields.h"
#include "satsurf/core/shape.h"

#include <array>
#include <string>

namespace satsurf::nn {

/// Every width, depth count and switch of the network.
struct ModelConfig {
  Index base = 8;  ///< feature channels at full resolution; x2, x4 at strides 2, 4
  std::array<Index, 3> hypotheses{64, 32, 8};   ///< heights per pixel at strides 4, 2, 1
  Index volume_base = 8;                        ///< channels of the first level of each 3D U-Net
  Index volume_levels = 3;                      ///< halvings inside each 3D U-Net
  std::array<Index, 3> head_width{64, 48, 32};  ///< channels of the surfel heads
  double interval_px = 0.5;   ///< disparity between neighbouring hypotheses, stage pixels
  double interval_min = 0.2;  ///< of the last stage, m
  double interval_max = 1.0;  ///< of the last stage, m
  bool variance_includes_reference = true;
  std::string rotation = "camera+residual";  ///< camera | camera+residual
  std::string fusion = "none";               ///< how monocular features join: none
  std::string guidance = "none";             ///< how rendered heights guide the next stage: none

  template <class Self, class V>
  static void fields(Self& s, V&& v) {
    v("base", s.base, Field{.help = "feature channels at full resolution", .min = 1, .max = 64});
    v("hypotheses", s.hypotheses,
      Field{.help = "height hypotheses per pixel at strides 4, 2 and 1", .min = 2, .max = 256});
    v("volume_base", s.volume_base,
      Field{.help = "first-level channels of each 3D U-Net", .min = 1, .max = 64});
    v("volume_levels", s.volume_levels,
      Field{.help = "halvings inside each 3D U-Net", .min = 1, .max = 4});
    v("head_width", s.head_width,
      Field{.help = "channels of the surfel heads", .min = 1, .max = 256});
    v("interval_px", s.interval_px,
      Field{.help = "disparity between neighbouring hypotheses",
            .unit = "stage px",
            .min = 0.05,
            .max = 4});
    v("interval_min", s.interval_min,
      Field{.help = "smallest interval of the last stage", .unit = "m", .min = 0.01, .max = 100});
    v("interval_max", s.interval_max,
      Field{.help = "largest interval of the last stage", .unit = "m", .min = 0.01, .max = 100});
    v("variance_includes_reference", s.variance_includes_reference,
      Field{.help = "count the reference view's own feature in the variance"});
    v("rotation", s.rotation,
      Field{.help = "surfel orientation", .choices = {"camera", "camera+residual"}});
    v("fusion", s.fusion,
      Field{.help = "how monocular features join the matching features", .choices = {"none"}});
    v("guidance", s.guidance,
      Field{.help = "how rendered heights guide the next stage", .choices = {"none"}});
  }

  friend bool operator==(const ModelConfig&, const ModelConfig&) = default;
};

/// Named configurations: tiny (tests), base8 (shipped weights), base16 (larger).
/// throws  ConfigError naming the presets there are
ModelConfig model_preset(const std::string& name);

/// Pixel sizes must be multiples of this: the coarsest stride times the U-Net's halvings.
Index size_multiple(const ModelConfig& config);

}  // namespace satsurf::nn

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/config.h"
#include "satsurf/nn/forward_memory.h"
#include "satsurf/nn/input.h"
#include "satsurf/nn/module.h"
#include "satsurf/splat/rasterize.h"

#include <array>
#include <cstddef>
#include <functional>
#include <memory>
#include <string>
#include <vector>

namespace satsurf::nn {

/// What one stage of the cascade predicts for all N source views, at the stage's resolution.
template <class T>
struct StageOutput {
  Index stride = 1;           ///< 4, 2 or 1 image pixels per stage pixel
  double interval = 0;        ///< between hypotheses, m
  BasicTensor<T> hypotheses;  ///< [N D h w] m; empty where the stage does not search (D = 0)
  BasicVar<T> probability;    ///< [N D h w] over the hypotheses; empty alike
  BasicVar<T> height;         ///< [N h w] expected height H_s, m in the local frame
  BasicVar<T> confidence;     ///< [N h w] max probability C_s
  Index choices = 0;          ///< hypotheses behind the confidence: D, or those of the stage before
  /// [N h w] probability that the surface lies within an interval of H_s, given all stages so far:
  /// that it does by this stage's distribution, times that each stage before has of the band the
  /// next one searches. Empty unless the configuration's confidence is `joint`.
  BasicTensor<T> within;
  /// N*h*w pixel-aligned surfels, and behind them those of the stages before if the configuration
  /// keeps all; aux channel 0 is the effective confidence.
  splat::BasicSurfels<T> surfels;
  BasicTensor<T> mono_height;  ///< [N h w] of the monocular branch, relative; empty without one
};

/// Before the names of the monocular branch's parameters among those of a model.
inline constexpr const char* kMonoPrefix = "mono.";

/// A stage's confidence as all that asks for one reads it, by `ModelConfig::confidence`:
///   raw    C_s = max P_s as published. Says how sharp a peak is within what the stage searches: it
///          is high, too, where the surface lies beyond and the nearest hypothesis takes it all.
///   floor  the same with the floor taken off that equal probabilities have, (C - 1/D) / (1 - 1/D)
///   joint  `within` of the stage
/// returns  [N h w] in [0, 1]
template <class T>
BasicTensor<T> effective_confidence(const ModelConfig& config, const StageOutput<T>& stage);

/// The three-stage coarse-to-fine cascade.
/// Source: SatSurfGS; stages and search after Gu et al. 2020 (CasMVSNet) and Gao et al. 2021
/// (SatMVS), pixel-aligned splats after Charatan et al. 2024 (pixelSplat).
template <class T>
class BasicModel {
 public:
  /// Parameters are initialised from `seed`.
  /// throws  ConfigError
  BasicModel(const ModelConfig& config, std::uint64_t seed);
  ~BasicModel();
  BasicModel(BasicModel&&) noexcept;
  BasicModel& operator=(BasicModel&&) noexcept;

  const ModelConfig& config() const;
  /// Those of the monocular branch begin with `kMonoPrefix`; no gradient reaches them.
  ParameterSet<T>& parameters();
  const ParameterSet<T>& parameters() const;

  /// Heights, confidences and surfels of every stage, coarse to fine.
  /// poll    called between layers, may throw to stop
  /// memory  takes what each part needed
  /// throws  ShapeError if views differ in size or are no multiple of `size_multiple`
  std::array<StageOutput<T>, 3> forward(const NetworkInput& scene,
                                        const std::function<void()>& poll = {},
                                        std::vector<PartMemory>* memory = nullptr) const;

 private:
  struct Parts;
  std::unique_ptr<Parts> parts_;
};
using Model = BasicModel<float>;

}  // namespace satsurf::nn

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/confidence.h"
#include "satsurf/nn/config.h"
#include "satsurf/nn/forward_memory.h"
#include "satsurf/nn/input.h"
#include "satsurf/nn/module.h"
#include "satsurf/nn/stage.h"

#include <array>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <vector>

namespace satsurf::nn {

/// Before the names of the monocular branch's parameters among those of a model.
inline constexpr const char* kMonoPrefix = "mono.";

/// Heights that a surface lies between, of what the first stage found; nothing if they are not known.
template <class T>
using NarrowSearch = std::function<std::optional<rpc::HeightRange>(const StageHeights<T>&)>;

/// The three-stage coarse-to-fine cascade: features of all views, then three times hypotheses,
/// search, guidance by the stage before and surfels; `run` in model.cpp is the whole way on one page.
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
  /// wanted  what to compute
  /// narrow  is asked between which heights, in local m, the surface lies, once the first stage has
  ///         searched the whole range: all others are ruled out from there on, in its own answer, too,
  ///         which then carries no gradient. May be empty, or know nothing.
  /// throws  ShapeError if views differ in size or are no multiple of `size_multiple`
  std::array<StageOutput<T>, 3> forward(const NetworkInput& scene,
                                        const std::function<void()>& poll = {},
                                        std::vector<PartMemory>* memory = nullptr,
                                        Wanted wanted = Wanted::surfels,
                                        const NarrowSearch<T>& narrow = {}) const;

 private:
  struct Parts;
  std::unique_ptr<Parts> parts_;
};
using Model = BasicModel<float>;

}  // namespace satsurf::nn

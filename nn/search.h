// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/config.h"
#include "satsurf/nn/cost_net.h"
#include "satsurf/nn/input.h"
#include "satsurf/nn/stage.h"
#include "satsurf/nn/visible_pairs.h"
#include "satsurf/ops/cost_volume.h"

#include <functional>
#include <optional>
#include <string>

namespace satsurf::nn {

/// Hypotheses on either side of the mode, of which its height is the mean (ops/mode_height.h).
inline constexpr Index kModeRadius = 2;

/// What a stage searches with.
template <class T>
struct SearchInput {
  BasicVar<T> features;       ///< [N C h w] F_s, of the FPN or fused
  BasicTensor<T> validity;    ///< [N h w] share of a view's data behind each pixel
  BasicTensor<T> hypotheses;  ///< [N D h w] m; empty where the stage does not search
  const StageHeights<T>* previous = nullptr;  ///< the stage before, none for the first
  BasicTensor<T> in_search;                   ///< [N h' w'] of JointProbability, from before
};

/// What it finds.
template <class T>
struct SearchOutput {
  StageHeights<T> heights;
  BasicTensor<T> in_next_search;  ///< [N h w] of JointProbability; empty if nobody reads it
};

/// The search of one stage. Every view in turn is the reference of a variance volume, which a 3D
/// U-Net turns into logits; these give the distribution of heights, its mean or the height of its
/// mode for H_s, as `ModelConfig::height` says, and the confidence C_s. A stage without hypotheses
/// takes heights and confidence of the one before, bilinear.
template <class T>
class HeightSearch {
 public:
  /// stage  counts from 0
  HeightSearch(ParameterSet<T>& p, const std::string& name, const ModelConfig& config,
               std::size_t stage);
  /// scene   its pixel transfers
  /// grid    of the stage
  /// poll    called between layers, may throw to stop
  /// throws  ShapeError
  SearchOutput<T> operator()(const NetworkInput& scene, const StageGrid& grid,
                             const SearchInput<T>& in, const std::function<void()>& poll) const;
  /// What the first stage finds if the surface lies within a range: hypotheses beyond it, by more than
  /// half an interval, have no probability, and the others share it. Carries no gradient.
  /// found  with a distribution; its storage is used up
  SearchOutput<T> within(const rpc::HeightRange& range, const StageGrid& grid,
                         SearchOutput<T> found) const;

 private:
  /// The distribution that logits [N D h w] stand for, and what follows from it.
  SearchOutput<T> found(const BasicVar<T>& logits, const BasicTensor<T>& hypotheses,
                        const StageGrid& grid, const BasicTensor<T>& in_search) const;
  BasicVar<T> logits(const NetworkInput& scene, const StageGrid& grid, const SearchInput<T>& in,
                     const std::function<void()>& poll) const;

  SweepOptions sweep_;
  bool joint_;
  HeightOf height_;
  std::optional<CostNet<T>> cost_;
  std::optional<VisiblePairs<T>> pairs_;
};

}  // namespace satsurf::nn

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/config.h"
#include "satsurf/nn/stage.h"

namespace satsurf::nn {

/// A stage's confidence as all that asks for one reads it, by `ModelConfig::confidence`:
///   raw    C_s = max P_s as published. Says how sharp a peak is within what the stage searches: it
///          is high, too, where the surface lies beyond and the nearest hypothesis takes it all.
///   floor  the same with the floor taken off that equal probabilities have, (C - 1/D) / (1 - 1/D)
///   joint  `joint_confidence` of the stage
/// returns  [N h w] in [0, 1]
template <class T>
BasicTensor<T> effective_confidence(const ModelConfig& config, const StageHeights<T>& stage);

/// The same for the surfel heads. Their losses reach the search by the published confidence alone:
/// the others have no gradient.
template <class T>
BasicVar<T> head_confidence(const ModelConfig& config, const StageHeights<T>& stage);

/// Probability that the surface lies within `reach` of a pixel's height, where each hypothesis
/// stands for the interval around it.
/// stage    what it searched, evenly spaced, with the probabilities
/// reach    m
/// returns  [N h w] in [0, 1]
/// throws   ShapeError
template <class T>
BasicTensor<T> probability_within(const StageHeights<T>& stage, double reach);

/// A sharp peak says little where the stages before looked in the wrong place, so the probabilities
/// of all stages multiply.
template <class T>
struct JointProbability {
  BasicTensor<T> confidence;      ///< [N h w] that the surface lies within an interval of H_s
  BasicTensor<T> in_next_search;  ///< [N h w] that it lies where the next stage searches
};

/// What a stage that searched adds to that.
/// stage        its heights and their distribution
/// next_reach   half of what the next stage that searches covers, m; 0 where none follows
/// in_search    [N h' w'] `in_next_search` of the stage before, empty at the first
template <class T>
JointProbability<T> joint_probability(const StageHeights<T>& stage, double next_reach,
                                      const BasicTensor<T>& in_search);

}  // namespace satsurf::nn

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/var.h"

namespace satsurf {

/// Softmax over the height hypotheses:  P_d = exp(l_d) / sum_k exp(l_k).
/// logits   [B D H W]
/// returns  [B D H W]
/// throws   ShapeError
template <class T>
BasicVar<T> softmax_hypotheses(const BasicVar<T>& logits);

/// Expected height:  H = sum_d P_d h_d.
/// probability  [B D H W]
/// heights      [B D H W] m; hypotheses carry no gradient
/// returns      [B H W] m
/// throws       ShapeError
template <class T>
BasicVar<T> expected_height(const BasicVar<T>& probability, const BasicTensor<T>& heights);

/// Confidence:  C = max_d P_d. The gradient goes to the first maximum.
/// probability  [B D H W]
/// returns      [B H W] in [1/D, 1]
/// throws       ShapeError
template <class T>
BasicVar<T> max_probability(const BasicVar<T>& probability);

/// What a pixel's hypotheses come to.
template <class T>
struct HeightDistribution {
  BasicVar<T> probability;  ///< [B D H W], of `softmax_hypotheses`
  BasicVar<T> height;       ///< [B H W] m, of `expected_height`
  BasicVar<T> confidence;   ///< [B H W] in [1/D, 1], of `max_probability`
};

/// The three above in one pass forward and one pass backward.
/// Any of the three may be used, or dropped. On the tape, probability and confidence stand above
/// height: their backward only keeps their gradient for height's, which runs last and takes all
/// three to the logits at once.
/// logits   [B D H W]
/// heights  [B D H W] m; hypotheses carry no gradient
/// throws   ShapeError
template <class T>
HeightDistribution<T> height_distribution(const BasicVar<T>& logits, const BasicTensor<T>& heights);

}  // namespace satsurf

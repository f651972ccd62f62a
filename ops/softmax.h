// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/var.h"

namespace satsurf {

/// What the logits of a pixel's height hypotheses come to.
template <class T>
struct HeightDistribution {
  BasicVar<T> probability;  ///< [B D H W], P_d = exp(l_d) / sum_k exp(l_k)
  BasicVar<T> height;       ///< [B H W] m, the expected height sum_d P_d h_d
  BasicVar<T> confidence;   ///< [B H W] in [1/D, 1], max_d P_d; gradient to the first maximum
};

/// Softmax over the height hypotheses, expected height and confidence in one pass forward and one
/// pass backward.
/// Any of the three may be used, or dropped. On the tape, probability and confidence stand above
/// height: their backward only keeps their gradient for height's, which runs last and takes all
/// three to the logits at once.
/// logits   [B D H W], at least one hypothesis
/// heights  [B D H W] m; hypotheses carry no gradient
/// throws   ShapeError
template <class T>
HeightDistribution<T> height_distribution(const BasicVar<T>& logits, const BasicTensor<T>& heights);

}  // namespace satsurf

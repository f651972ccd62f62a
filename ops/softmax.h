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

}  // namespace satsurf

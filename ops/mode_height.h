// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/var.h"

namespace satsurf {

/// The height of the most probable place of a distribution, between the hypotheses:
///   d* = argmax_d sum_{|k - d| <= min(1, radius)} P_k (the first of equals),
///   H  = sum_{|d - d*| <= radius} P_d h_d / sum_{|d - d*| <= radius} P_d
/// The expectation over all hypotheses lies between two surfaces where both are possible, and on
/// neither; one hypothesis alone may stand out beside a surface whose probability lies on three.
/// The gradient flows to the probabilities near the mode.
/// Source: after Chen et al. 2019 (over-smoothing of expected disparities).
/// probability  [B D H W], at least one hypothesis
/// heights      [B D H W] m; hypotheses carry no gradient
/// radius       hypotheses on either side, 0 or more
/// returns      [B H W] m
/// throws       ShapeError; ConfigError for a negative radius
template <class T>
BasicVar<T> mode_height(const BasicVar<T>& probability, const BasicTensor<T>& heights,
                        Index radius);

}  // namespace satsurf

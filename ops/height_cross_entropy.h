// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/var.h"

namespace satsurf {

/// Weighted mean of the cross-entropy between a distribution over evenly spaced heights and the
/// truth:
///   -sum_d q_d log(P_d + 1e-12),  q the two hypotheses around the truth, by linear interpolation
/// so that the target's expectation is the truth. Within half an interval beyond the first or last
/// hypothesis that one is the target; farther out no weight can reach the truth, and the pixel does
/// not count. A single hypothesis has no interval: it is the target of every truth.
/// Source: after Chen et al. 2019 and Xu et al. 2024 (unimodal targets).
/// probability  [B D H W], D at least 1
/// heights      [B D H W] m, rising with d by the same interval everywhere
/// truth        [B H W] m; may be anything where the weight is 0
/// weight       [B H W]
/// returns      a scalar; 0 where nothing counts
/// throws       ShapeError
template <class T>
BasicVar<T> height_cross_entropy(const BasicVar<T>& probability, const BasicTensor<T>& heights,
                                 const BasicTensor<T>& truth, const BasicTensor<T>& weight);

/// The weights of the pixels whose truth is within reach of their hypotheses, as above; 0 elsewhere.
/// returns  [B H W]
/// throws   ShapeError
template <class T>
BasicTensor<T> within_hypotheses(const BasicTensor<T>& heights, const BasicTensor<T>& truth,
                                 const BasicTensor<T>& weight);

}  // namespace satsurf

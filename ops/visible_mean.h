// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/var.h"

namespace satsurf {

/// Mean cost of the pairs of a reference view with each of J others, a pair counted by how visible
/// the reference pixel is in its other view:
///   P_k = sum_j v_j m_j d_jk / S,  S = sum_j v_j m_j,  P_K = S / J
///   v_j = e + (1 - e) s_j,  e = 1e-4
///   s_j = max over heights of 1 / (1 + exp(-l_j)), of those at which view j sees the point
/// so that a view in which a building stands before the point loses its say at all heights, unless
/// nobody else has one. Where no view sees the point all are 0.
/// costs    [J K+1 D H W] d_jk, k = 0 .. K - 1, and m_j: above 0 where view j sees the point, without
///          gradient
/// logits   [J 1 D H W] l_j
/// returns  [K+1 D H W]
/// throws   ShapeError
/// Source: Wang et al. 2021 (PatchmatchNet), section 3.2 (view weights), costs of pairs instead of
/// similarities.
template <class T>
BasicVar<T> visible_mean(const BasicVar<T>& costs, const BasicVar<T>& logits);

}  // namespace satsurf

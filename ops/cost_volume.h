// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/quadratic.h"
#include "satsurf/core/var.h"

#include <vector>

namespace satsurf {

/// Plane-sweep variance volume of one reference view. For every reference pixel and height
/// hypothesis, the features of the other views are sampled bilinearly at the transferred pixel and
/// the variance per channel is taken over the views that see the point:
///   V = (sum_j m_j f_j^2) / n - ((sum_j m_j f_j) / n)^2,   n = sum_j m_j
/// m_j = 1 if the transferred pixel lies inside view j (0 <= x <= W-1, likewise y) and its nearest
/// pixel is valid; the reference itself always counts. Where n < 2 the variance is 0. The gradient
/// flows to the features, not to heights or sampling positions.
/// Source: Yao et al. 2018 (MVSNet), eq. 2, with RPC transfer by quadratics and counts per sample
/// (ours).
/// features           [N C H W], one map per view
/// reference          index of the reference view
/// maps               N entries; maps[j](x, y, z) is the pixel in view j of reference pixel (x, y)
///                    at height z, both in pixels of these maps; entry `reference` is ignored
/// heights            [D H W] hypotheses, m, in the frame of the maps
/// valid              [N H W], 1 where a pixel may be sampled; empty for everywhere
/// include_reference  false: the variance is over the other views alone
/// returns            [C D H W]
/// throws             ShapeError
/// memory             nothing is kept of the warps: backward computes them again
template <class T>
BasicVar<T> plane_sweep_variance(const BasicVar<T>& features, Index reference,
                                 const std::vector<Quadratic>& maps, const BasicTensor<T>& heights,
                                 const BasicTensor<T>& valid, bool include_reference = true);

}  // namespace satsurf

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/var.h"

namespace satsurf {

/// Weighted mean of the smooth-L1 distance:
///   sum(w l(x - target)) / max(sum(w), 1e-12),  l(e) = e^2 / (2 beta) for |e| < beta,
///                                               else |e| - beta / 2
/// Source: Girshick 2015 (Fast R-CNN), eq. 3, with the transition point as a parameter.
/// x        any shape
/// target   x's shape; may be NaN where the weight is 0
/// weight   x's shape, or an empty tensor for ones
/// beta     where the distance turns linear, in units of x
/// returns  a scalar
/// throws   ShapeError, ConfigError for a beta that is not above 0
template <class T>
BasicVar<T> smooth_l1(const BasicVar<T>& x, const BasicTensor<T>& target,
                      const BasicTensor<T>& weight, T beta);

/// Weighted mean of the squared difference: sum(w (x - target)^2) / max(sum(w), 1e-12).
/// x        any shape
/// target   x's shape; may be NaN where the weight is 0
/// weight   x's shape, or an empty tensor for ones
/// returns  a scalar
/// throws   ShapeError
template <class T>
BasicVar<T> mse(const BasicVar<T>& x, const BasicTensor<T>& target, const BasicTensor<T>& weight);

}  // namespace satsurf

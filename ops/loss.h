// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/var.h"

namespace satsurf {

/// Weighted mean of the smooth-L1 distance: sum(w l(x - target)) / max(sum(w), 1e-12), with
/// l(e) = e^2 / (2 beta) for |e| < beta, else |e| - beta / 2. Elements of weight 0 may be NaN in
/// the target. Source: Girshick 2015 (Fast R-CNN), eq. 3, with the transition point as a parameter.
/// x, target, weight: equal shapes. weight: an empty tensor means all ones. returns a scalar.
/// throws ShapeError
template <class T>
BasicVar<T> smooth_l1(const BasicVar<T>& x, const BasicTensor<T>& target,
                      const BasicTensor<T>& weight, T beta);

/// Weighted mean of the squared difference; weights as in smooth_l1.
/// returns a scalar. throws ShapeError
template <class T>
BasicVar<T> mse(const BasicVar<T>& x, const BasicTensor<T>& target, const BasicTensor<T>& weight);

}  // namespace satsurf

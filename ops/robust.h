// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/var.h"

#include <span>

namespace satsurf {

/// Where a map lies and how far it spreads, as told by its middle values: gross errors in less than
/// half of the pixels move neither far.
template <class T>
struct RobustScale {
  T median = 0;
  T mad = 0;  ///< median of |x - median|
};

/// Median and median absolute deviation; for an even number of values, the mean of the middle two.
/// values   any number
/// valid    1 where a value counts and 0 where not, or empty for all
/// returns  zeros if no value counts; NaNs if a NaN does, or if the median is not finite
/// throws   ShapeError
/// cost     O(values) on average, and a copy of them
template <class T>
RobustScale<T> robust_scale(std::span<const T> values, std::span<const T> valid);

/// Every map centred at its median and divided by its median absolute deviation:
///   y = (x - median) / (MAD + eps)  where valid, else 0
/// x        [N H W]; may be NaN where not valid
/// valid    [N H W] 1 where x counts and 0 where not, or an empty tensor for ones
/// eps      positive, in units of x: the deviation below which a map counts as flat
/// returns  [N H W] unitless
/// throws   ShapeError, ConfigError
template <class T>
BasicTensor<T> robust_normalised(const BasicTensor<T>& x, const BasicTensor<T>& valid, T eps);

/// The same on the tape. Median and MAD are constants to the backward pass, dy/dx = 1 / (MAD + eps):
/// their true gradients would put the whole weight of a map on the few pixels in its middle.
template <class T>
BasicVar<T> robust_normalised(const BasicVar<T>& x, const BasicTensor<T>& valid, T eps);

}  // namespace satsurf

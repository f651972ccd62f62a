// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/var.h"

namespace satsurf {

/// Sum of all elements, partial sums in double and in a fixed order.
/// x        any shape
/// returns  a scalar
template <class T>
BasicVar<T> sum(const BasicVar<T>& x);

/// Mean of all elements, summed as in `sum`.
/// x        any shape with at least one element
/// returns  a scalar
/// throws   ShapeError
template <class T>
BasicVar<T> mean(const BasicVar<T>& x);

/// Share that the masked elements have in the mean over all valid ones, summed as in `sum`:
///   sum(mask x) / max(number of valid elements, 1)
/// A mask that leaves elements out makes it smaller; a weighted mean (ops/loss.h) stays as large.
/// x        any shape; may be NaN where the mask is 0
/// mask     x's shape, weights that are 0 where not valid
/// valid    x's shape, 1 where an element counts and 0 where not, or an empty tensor for ones
/// returns  a scalar
/// throws   ShapeError
template <class T>
BasicVar<T> masked_mean(const BasicVar<T>& x, const BasicTensor<T>& mask,
                        const BasicTensor<T>& valid);

}  // namespace satsurf

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

}  // namespace satsurf

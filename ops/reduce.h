// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/var.h"

namespace satsurf {

/// Sum of all elements, as a scalar. Partial sums are in double and in a fixed order.
template <class T>
BasicVar<T> sum(const BasicVar<T>& x);
/// Mean of all elements, as a scalar. throws ShapeError if there are none
template <class T>
BasicVar<T> mean(const BasicVar<T>& x);

}  // namespace satsurf

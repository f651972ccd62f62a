// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/var.h"

namespace satsurf {

/// Matrix product op(a) op(b), op = transpose where asked.
/// a        [M K], or [K M] with transpose_a
/// b        [K N], or [N K] with transpose_b
/// returns  [M N]
/// throws   ShapeError
template <class T>
BasicVar<T> matmul(const BasicVar<T>& a, const BasicVar<T>& b, bool transpose_a = false,
                   bool transpose_b = false);

}  // namespace satsurf

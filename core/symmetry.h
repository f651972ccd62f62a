// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/tensor.h"

namespace satsurf {

/// Symmetries of the square.
inline constexpr Index kSymmetries = 8;

/// One of the eight symmetries of the square: bit 0 mirrors columns, bit 1 mirrors rows, bit 2 swaps
/// the two before.
/// map       [S S] or [C S S]
/// symmetry  0 to 7
/// throws    ShapeError
Tensor turned(const Tensor& map, Index symmetry);

}  // namespace satsurf

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/tensor.h"

namespace satsurf {

// Squares of (2 radius + 1)^2 cells, cut off at the edges.

/// Mean over a square.
/// grid     [H W]
/// returns  [H W]
Tensor box_mean(const Tensor& grid, Index radius);

/// Largest value of a square.
/// grid     [H W], no NaN
/// returns  [H W]
Tensor box_max(const Tensor& grid, Index radius);

}  // namespace satsurf

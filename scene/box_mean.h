// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/tensor.h"

namespace satsurf::scene {

/// Mean over a square of (2 radius + 1)^2 cells, cut off at the edges.
/// grid     [H W]
/// returns  [H W]
Tensor box_mean(const Tensor& grid, Index radius);

}  // namespace satsurf::scene

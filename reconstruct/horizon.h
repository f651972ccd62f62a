// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/tensor.h"

#include <array>

namespace satsurf::reconstruct {

/// The height of every cell up to which a surface hides it from a satellite:
///   H(p) = max_{t > 0} S(p + t g) - t
/// worked out from cell to cell along the sight lines, so that a thin thing hides the less the further
/// it is.
/// surface  [H W] m, row 0 north; unknown cells, NaN, are in nobody's way
/// step     side of a cell, m
/// toward   g, ground towards the satellite (east, north) per metre of height
/// returns  [H W] m, -infinity where nothing stands on the way
Tensor sight_horizon(const Tensor& surface, double step, const std::array<double, 2>& toward);

}  // namespace satsurf::reconstruct

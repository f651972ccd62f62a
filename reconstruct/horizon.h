// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/tensor.h"

#include <array>

namespace satsurf::reconstruct {

/// Of every cell the height below which a surface hides it from a camera far away: the highest line
/// to the camera that another cell stands in the way of. The cell itself hides nothing. Each cell
/// lies on one chain of neighbours towards the camera, which strays from the straight line by half a
/// cell at most, so all cells together take one pass.
/// surface    [H W] m, row 0 in the north; unknown (NaN) cells hide nothing
/// step       side of a cell, m
/// to_camera  east and north per metre of height, m
/// returns    [H W] m, minus infinity where nothing is in the way
/// throws     ShapeError
Tensor horizon(const Tensor& surface, double step, const std::array<double, 2>& to_camera);

}  // namespace satsurf::reconstruct

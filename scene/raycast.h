// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/quadratic.h"
#include "satsurf/core/tensor.h"

#include <cmath>

namespace satsurf::scene {

/// Heights on a regular grid of the local frame; row 0 is north. Cell (i, j) is centred at
/// x = x0 + (j + 0.5) step, y = y0 - (i + 0.5) step: (x0, y0) is the upper-left corner.
struct HeightField {
  Tensor z;  ///< [H W] m in the local frame; NaN where unknown
  double x0 = 0, y0 = 0, step = 0.5;
};

/// The cell of a field that holds a place, row by row; -1 beyond the field.
/// x, y  local m
inline Index cell_at(const HeightField& field, double x, double y) {
  const double column = std::floor((x - field.x0) / field.step),
               row = std::floor((field.y0 - y) / field.step);
  const Index H = field.z.dim(0), W = field.z.dim(1);
  return column >= 0 && row >= 0 && column < static_cast<double>(W) && row < static_cast<double>(H)
             ? static_cast<Index>(row) * W + static_cast<Index>(column)
             : -1;
}

/// First intersection of every pixel's ray with the surface, from above. Cells are square columns
/// with vertical walls (what a DSM says); a ray that reaches an unknown cell or leaves the grid
/// before it hits yields NaN.
/// local_from_pixel  localisation (x, y, z) -> local (x, y)
/// height, width     of the image, px
/// returns           [height width] z of the hit, m
Tensor heights_in_view(const HeightField& field, const Quadratic& local_from_pixel, Index height,
                       Index width);

}  // namespace satsurf::scene

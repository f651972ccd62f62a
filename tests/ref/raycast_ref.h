// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/scene/raycast.h"

#include <cmath>
#include <limits>

namespace satsurf::ref {

/// What heights_in_view says about one ray, by marching down it in `steps` equal pieces. Walls are
/// found to a piece's height; where a ray passes an edge by less than that the answers may differ.
inline double height_by_marching(const scene::HeightField& field, const Quadratic& local_from_pixel,
                                 double x, double y, int steps) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  double low = 1e300, high = -1e300;
  for (const float z : field.z.values()) {
    if (std::isnan(z)) continue;
    low = std::min(low, static_cast<double>(z));
    high = std::max(high, static_cast<double>(z));
  }
  const auto top = local_from_pixel(x, y, high), bottom = local_from_pixel(x, y, low);
  bool inside = false;
  Index before = -1;
  for (int k = 0; k <= steps; ++k) {
    const double s = static_cast<double>(k) / steps, z = high + s * (low - high);
    const double px = top[0] + s * (bottom[0] - top[0]), py = top[1] + s * (bottom[1] - top[1]);
    const double col = std::floor((px - field.x0) / field.step);
    const double row = std::floor((field.y0 - py) / field.step);
    const bool on_grid = col >= 0 && row >= 0 && col < static_cast<double>(field.z.dim(1)) &&
                         row < static_cast<double>(field.z.dim(0));
    if (!on_grid) {
      if (inside) return nan;
      continue;
    }
    const Index cell = static_cast<Index>(row) * field.z.dim(1) + static_cast<Index>(col);
    const auto surface = static_cast<double>(field.z[cell]);
    if (std::isnan(surface)) return nan;
    if (z <= surface) {
      if (!inside && k > 0) return nan;     // through the cut edge of the grid
      return cell == before ? surface : z;  // the top of a column, or its wall
    }
    inside = true;
    before = cell;
  }
  return nan;
}

}  // namespace satsurf::ref

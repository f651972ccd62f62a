// SPDX-License-Identifier: Apache-2.0
#pragma once

namespace satsurf::scene {

/// A rectangle of ground, local m.
struct Ground {
  double x0 = 0, y0 = 0, x1 = 0, y1 = 0;
  double width() const { return x1 - x0; }
  double height() const { return y1 - y0; }
  /// Whether a point lies in it or on its western or southern edge, so that it is in one of two
  /// neighbours.
  bool contains(double x, double y) const { return x >= x0 && x < x1 && y >= y0 && y < y1; }
};

}  // namespace satsurf::scene

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/scene/raycast.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <vector>

namespace satsurf::scene {

/// A height field prepared for walking rays through its columns: blocks of columns that a ray
/// passes above are skipped in one step.
class ColumnField {
 public:
  /// Where a ray ends. `row` is -1 when it ends nowhere known.
  struct Hit {
    Index row = -1, col = -1;  ///< the column that was hit
    float z = std::numeric_limits<float>::quiet_NaN();
    bool side = false;                     ///< a vertical wall, not the top of the column
    Index front_row = -1, front_col = -1;  ///< for a wall: the column in front of it
  };

  /// Keeps a reference to the elements of `field`, which must outlive this object.
  explicit ColumnField(const HeightField& field);

  double low() const { return low_; }    ///< lowest known height, m
  double high() const { return high_; }  ///< highest known height, m
  /// No cell is known.
  bool empty() const { return !(low_ <= high_); }

  /// Walks from (x_high, y_high) at `high()` to (x_low, y_low) at `low()`, m in the local frame.
  Hit walk(double x_high, double y_high, double x_low, double y_low) const;

 private:
  /// The highest column of every square block; +infinity where it holds an unknown one.
  struct Blocks {
    Index columns;  ///< of blocks
    std::vector<float> high;

    float at(Index row, Index column) const {
      return high[static_cast<std::size_t>(row * columns + column)];
    }
  };
  static constexpr Index kBlock = 8;  // 8 x 8 columns: measured best of 4, 8, 16 on city scenes
  static constexpr Index kGroup = 8;  // 8 x 8 blocks

  const float* z_;
  Index rows_, cols_;
  double x0_, y0_, inverse_step_;
  double low_ = std::numeric_limits<double>::infinity();
  double high_ = -std::numeric_limits<double>::infinity();
  Blocks blocks_, groups_;
};

}  // namespace satsurf::scene

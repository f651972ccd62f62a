// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/evaluate/causes.h"
#include "satsurf/scene/ray_walk.h"

#include <array>
#include <vector>

namespace satsurf::evaluate {

/// What cameras and the sun see of a point.
struct Sight {
  Index contain = 0, see = 0;  ///< views into which it falls, and those of them that see it
  bool shaded = false;         ///< in cast shadow in one of the former
};

/// Straight lines from the true surface to the cameras and the sun. Its columns are solid; unknown
/// ones are in nobody's way.
class SightLines {
 public:
  /// The truth and the views must outlive this object.
  SightLines(const scene::HeightField& truth, const std::vector<LitView>& views);

  /// Of the centre of a known cell's top.
  Sight at(Index row, Index col) const;
  /// No cell is known.
  bool empty() const { return columns_.empty(); }

 private:
  /// Whether a camera sees a point.
  /// q         its pixel
  /// row, col  its cell
  /// p         local m
  bool seen(const nn::PosedImage& image, const std::array<double, 2>& q, Index row, Index col,
            const std::array<double, 3>& p) const;
  /// Whether a straight line from above, given at the surface's highest and lowest height, meets
  /// the surface in this cell first.
  bool reached(Index row, Index col, const std::array<double, 2>& top,
               const std::array<double, 2>& bottom) const;

  const scene::HeightField& truth_;
  const std::vector<LitView>& views_;
  scene::HeightField solid_;
  scene::ColumnField columns_;
  Tensor clear_of_rays_, clear_of_light_;  ///< heights above which no line has to be followed
};

}  // namespace satsurf::evaluate

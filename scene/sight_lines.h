// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/scene/lit_view.h"
#include "satsurf/scene/ray_walk.h"

#include <array>
#include <vector>

namespace satsurf::scene {

/// What cameras and the sun see of a point.
struct Sight {
  Index contain = 0, see = 0;  ///< views into which it falls, and those of them that see it
  bool shaded = false;         ///< in cast shadow in one of the former
};

/// Straight lines from a surface to the cameras and the sun. Its columns are solid; unknown
/// ones are in nobody's way.
class SightLines {
 public:
  /// The surface and the views must outlive this object.
  SightLines(const HeightField& surface, const std::vector<LitView>& views);

  /// Of the centre of a known cell's top.
  Sight at(Index row, Index col) const;
  /// Whether one of the views sees the centre of a known cell's top. Pixels that are not valid see
  /// as well.
  bool sees(std::size_t view, Index row, Index col) const;
  /// No cell is known.
  bool empty() const { return columns_.empty(); }

 private:
  /// Centre of a cell's top, local m.
  std::array<double, 3> centre(Index row, Index col) const;
  /// Whether a camera sees a point.
  /// q         its pixel
  /// row, col  its cell
  /// p         local m
  bool reaches(const nn::PosedImage& image, const std::array<double, 2>& q, Index row, Index col,
               const std::array<double, 3>& p) const;
  /// Whether a straight line from above, given at the surface's highest and lowest height, meets
  /// the surface in this cell first.
  bool reached(Index row, Index col, const std::array<double, 2>& top,
               const std::array<double, 2>& bottom) const;

  const HeightField& surface_;
  const std::vector<LitView>& views_;
  HeightField solid_;
  ColumnField columns_;
  Tensor clear_of_rays_, clear_of_light_;  ///< heights above which no line has to be followed
};

}  // namespace satsurf::scene

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/input.h"
#include "satsurf/scene/raycast.h"

#include <vector>

namespace satsurf::reconstruct {

/// How complete a surface is.
struct CellCount {
  Index found = 0;     ///< cells with a height
  Index expected = 0;  ///< those, and what two or more images show in the middle of their heights

  double share() const {
    return expected > 0 ? static_cast<double>(found) / static_cast<double>(expected) : 0;
  }
};

/// Counts the cells of a surface.
/// images    whole ones, in the frame of the surface
/// middle    of the heights, local m
/// unwanted  [H W] 1 where cells are not counted, or empty
CellCount count_cells(const scene::HeightField& surface, const std::vector<nn::PosedImage>& images,
                      double middle, const Tensor& unwanted);

}  // namespace satsurf::reconstruct

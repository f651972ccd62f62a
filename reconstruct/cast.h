// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/scene/raycast.h"
#include "satsurf/splat/rasterize.h"

namespace satsurf::reconstruct {

/// Surfels moved along the rays of their pixels to where these first meet a surface, so that
/// surfels, mesh and rendered views show the same one. Those whose ray meets nothing known go.
/// Colour, size, orientation and opacity stay what they were.
/// rays     [P 2] m east and north that a surfel's ray moves per metre of height
/// surface  its cells are columns with vertical walls
/// throws   ShapeError
splat::Surfels cast_on(const splat::Surfels& surfels, const Tensor& rays,
                       const scene::HeightField& surface);

}  // namespace satsurf::reconstruct

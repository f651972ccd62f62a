// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/reconstruct/reconstruct.h"

namespace satsurf::reconstruct {

/// Discs that were cast onto a surface (`cast_on`) and face their cameras, laid in it.
/// Normal    that of the plane of the disc's cell, see `cell_slopes`; on a wall, a step that this
///           plane does not explain, that of the wall, across the edge of the columns as high. Where
///           it is more than 65 degrees off the ray to the camera, it is turned towards the ray.
/// Height    that of the plane, where this is up to the side of a cell away; on a wall, what it was.
///           East and north stay.
/// Size      across the tilt as before. Along the tilt a disc on a wall is as much longer as it takes
///           to look as it did from its camera; others grow by 18 % at most, to the 0.71 pixels that
///           the splatter's filter shows them with anyway.
/// Opacity   0.3: two of them stop half the light.
/// Colour and auxiliary channels stay.
/// surfels  facing discs: equal scales, their normals along the rays
/// surface  that they were cast onto
/// returns  as many; the same bits for any number of threads
/// throws   ShapeError
splat::Surfels laid_in(const splat::Surfels& surfels, const scene::HeightField& surface);

/// The surfels as `surfels.ply` has them: those of a refined surface laid in it, others as they are.
splat::Surfels delivered_surfels(const Reconstruction& made);

}  // namespace satsurf::reconstruct

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/splat/rasterize.h"

#include <vector>

namespace satsurf::splat {

/// The surfels of several sets, one set behind the other.
/// parts   one or more; a tensor that none of them has is left out
/// throws  ShapeError for none, and where some of them have a tensor that others do not
template <class T>
BasicSurfels<T> joined(const std::vector<BasicSurfels<T>>& parts);

/// Some of a set, without their gradients.
/// keep  their numbers
Surfels selected(const Surfels& surfels, const std::vector<Index>& keep);

/// A set with fewer surfels that still covers the surface: of those in one cube of a regular grid the
/// most opaque is left (of equals the first), with standard deviations of half the cube at least.
/// The cubes are as small as the number allows, to a fiftieth of their side.
/// most    surfels that may be left, 1 or more; a set that is no larger comes back as it is
/// throws  Error for a number below 1
Surfels thinned(const Surfels& surfels, Index most);

}  // namespace satsurf::splat

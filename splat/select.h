// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/splat/rasterize.h"

#include <vector>

namespace satsurf::splat {

/// The surfels of several sets, one set behind the other.
/// parts  one or more
template <class T>
BasicSurfels<T> joined(const std::vector<BasicSurfels<T>>& parts);

/// Some of a set, without their gradients.
/// keep  their numbers
Surfels selected(const Surfels& surfels, const std::vector<Index>& keep);

}  // namespace satsurf::splat

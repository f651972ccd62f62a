// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/scene/simulate/city.h"

namespace satsurf::scene::simulate {

/// Deviation of the reflectance from its mean, relative: per cell, below 2 m, 2 to 16 m, and wider.
struct Texture {
  float grain, fine, middle, wide;
};
Texture texture_of(Material material);

/// Fills in the slopes within each surface, and how much of the sky is hidden by what stands
/// around, in `cells` and `floor`.
void shape_cells(City& city);

}  // namespace satsurf::scene::simulate

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/rng.h"
#include "satsurf/scene/simulate/city.h"
#include "satsurf/scene/simulate/scene.h"

namespace satsurf::scene::simulate {

/// Dresses a part of a given surface: roofs by regions of even height, ground and crowns by noise.
/// Beyond its edges the surface goes on mirrored, so that every view is full.
/// surface  with classes or without; without, what is high and rough is a tree
/// frame    of the plan
/// plan     its grid: x0, y0, step and size
City city_on(const GivenSurface& surface, const rpc::LocalFrame& frame, const CityPlan& plan,
             const Rng& rng);

}  // namespace satsurf::scene::simulate

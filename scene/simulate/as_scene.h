// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/scene/scene.h"
#include "satsurf/scene/simulate/scene.h"

#include <string>

namespace satsurf::scene {

/// A made-up place as `load_scene` would give it had it been written and read: with its truth and
/// classes, and a height range 5 m wider than the surface. The rasters are taken over, not copied.
/// name  of the scene; its views are NAME_001 and so on
Scene as_scene(SimulatedScene made, const std::string& name);

}  // namespace satsurf::scene

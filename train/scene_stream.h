// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/scene/scene.h"
#include "satsurf/scene/simulate/scene.h"
#include "satsurf/train/stream.h"

#include <cstdint>

namespace satsurf::train {

/// Scenes that are made up while a training runs.
class SceneStream : public Stream<scene::Scene> {
 public:
  /// uses, pool  as `Stream`
  SceneStream(const scene::SimulateConfig& config, std::uint64_t seed, Index uses, Index pool);
};

/// Scene number `number` of those.
scene::Scene made_up_scene(scene::SimulateConfig config, std::uint64_t seed, Index number);

}  // namespace satsurf::train

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/train/scene_stream.h"

#include "satsurf/scene/simulate/as_scene.h"

#include <string>
#include <utility>

namespace satsurf::train {

SceneStream::SceneStream(const scene::SimulateConfig& config, std::uint64_t seed, Index uses,
                         Index pool)
    : Stream(uses, pool, [=](Index number) { return made_up_scene(config, seed, number); }) {
  scene::check_config(config);
}

scene::Scene made_up_scene(scene::SimulateConfig config, std::uint64_t seed, Index number) {
  config.heights = false;
  return scene::as_scene(scene::simulate_scene(config, seed, number),
                         "scene" + std::to_string(number));
}

}  // namespace satsurf::train

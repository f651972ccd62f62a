// SPDX-License-Identifier: Apache-2.0
#include "satsurf/train/scene_stream.h"

#include "satsurf/scene/simulate/as_scene.h"

#include <string>

namespace satsurf::train {

SceneStream::SceneStream(const scene::SimulateConfig& config, std::uint64_t seed, Index uses,
                         Index pool)
    : config_(config), seed_(seed), uses_(uses), pool_(pool) {
  config_.heights = false;
  scene::check_config(config_);
}

std::shared_ptr<const scene::Scene> SceneStream::scene(Index number) {
  std::promise<std::shared_ptr<const scene::Scene>> promise;
  Made made;
  bool is_new = false;
  {
    const std::lock_guard lock(mutex_);
    // A sample of the same step may still want a scene that the newest sample no longer does.
    scenes_.erase(scenes_.begin(), scenes_.lower_bound(number - 2 * pool_));
    is_new = !scenes_.contains(number);
    if (is_new) scenes_[number] = promise.get_future().share();
    made = scenes_[number];
  }
  if (!is_new) return made.get();  // made already, or whoever makes it is about to be done
  try {
    promise.set_value(std::make_shared<const scene::Scene>(scene::as_scene(
        scene::simulate_scene(config_, seed_, number), "scene" + std::to_string(number))));
  } catch (...) {
    promise.set_exception(std::current_exception());
  }
  return made.get();
}

}  // namespace satsurf::train

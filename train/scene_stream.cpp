// SPDX-License-Identifier: Apache-2.0
#include "satsurf/train/scene_stream.h"

#include "satsurf/scene/simulate/as_scene.h"

#include <string>
#include <utility>

namespace satsurf::train {

KeptScene::KeptScene(scene::Scene scene) : rest_(std::move(scene)) {
  for (scene::View& view : rest_.views) {
    pixels_.push_back(
        {PackedTensor::levels(view.rgb, 1.0f / 255.0f), PackedTensor::levels(view.valid, 1)});
    view.rgb = {}, view.valid = {};
  }
  classes_ = PackedTensor::levels(rest_.classes, 1);
  rest_.classes = {};
}

scene::Scene KeptScene::scene() const {
  scene::Scene out = rest_;
  for (std::size_t v = 0; v < pixels_.size(); ++v) {
    out.views[v].rgb = pixels_[v].rgb.tensor();
    out.views[v].valid = pixels_[v].valid.tensor();
  }
  out.classes = classes_.tensor();
  return out;
}

std::size_t KeptScene::bytes() const {
  std::size_t sum = classes_.bytes();
  for (const Pixels& p : pixels_) sum += p.rgb.bytes() + p.valid.bytes();
  return sum;
}

SceneStream::SceneStream(const scene::SimulateConfig& config, std::uint64_t seed, Index uses,
                         Index pool)
    : Stream(uses, pool,
             [=](Index number) { return KeptScene(made_up_scene(config, seed, number)); }) {
  scene::check_config(config);
}

scene::Scene made_up_scene(scene::SimulateConfig config, std::uint64_t seed, Index number) {
  config.heights = false;
  return scene::as_scene(scene::simulate_scene(config, seed, number),
                         "scene" + std::to_string(number));
}

}  // namespace satsurf::train

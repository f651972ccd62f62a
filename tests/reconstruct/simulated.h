// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/rpc/read.h"
#include "satsurf/scene/image_in_memory.h"
#include "satsurf/scene/simulate/scene.h"

#include <cmath>
#include <cstdint>
#include <string>
#include <vector>

namespace satsurf::test {

/// A made-up place without water.
/// number  of the place
inline scene::SimulatedScene place(scene::SceneKind kind, Index pixels, Index views,
                                   std::int64_t number = 0) {
  scene::SimulateConfig config = scene::SimulateConfig();
  config.pixels = pixels, config.views = views, config.gsd = 0.5, config.kinds = {kind};
  config.water = 0;
  return scene::simulate_scene(config, 5, number);
}

/// A made-up village.
inline scene::SimulatedScene village(Index pixels, Index views) {
  return place(scene::SceneKind::village, pixels, views);
}

/// The images of a made-up scene as a caller would hold them; owns their bytes.
class HeldImages {
 public:
  HeldImages() = default;
  explicit HeldImages(const scene::SimulatedScene& made) {
    for (std::size_t i = 0; i < made.views.size(); ++i)
      add("view_" + std::to_string(i), made.views[i].rgb, 255, made.views[i].rpc);
  }
  /// rgb    [3 H W]
  /// scale  brings its values to whole numbers from 0 to 255
  void add(const std::string& name, const Tensor& rgb, float scale, const rpc::Rpc& camera) {
    auto& bytes = bytes_.emplace_back();
    for (const float v : rgb.values())
      bytes.push_back(static_cast<std::uint8_t>(std::lround(scale * v)));
    images_.push_back({.name = name,
                       .rpc = camera,
                       .width = rgb.dim(2),
                       .height = rgb.dim(1),
                       .channels = 3,
                       .pixels = std::span<const std::uint8_t>()});
  }
  std::vector<scene::ImageInMemory> images() const {
    std::vector<scene::ImageInMemory> out = images_;
    for (std::size_t i = 0; i < out.size(); ++i)
      out[i].pixels = std::span<const std::uint8_t>(bytes_[i]);
    return out;
  }
  const std::vector<std::uint8_t>& bytes(std::size_t i) const { return bytes_[i]; }

 private:
  std::vector<std::vector<std::uint8_t>> bytes_;
  std::vector<scene::ImageInMemory> images_;
};

/// The height range that the truth names, with a margin.
inline rpc::HeightRange range_of(const scene::SimulatedScene& made) {
  return rpc::HeightRange{made.h_min, made.h_max}.widened(2);
}

}  // namespace satsurf::test

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/packed_tensor.h"
#include "satsurf/scene/scene.h"
#include "satsurf/scene/simulate/scene.h"
#include "satsurf/train/stream.h"

#include <cstddef>
#include <cstdint>
#include <vector>

namespace satsurf::train {

/// A scene with its pixels in bytes where that loses nothing, as it does for images of 8 bits.
class KeptScene {
 public:
  explicit KeptScene(scene::Scene scene);
  /// As it was, to the bit; what lies in other memory than pixels and classes is shared.
  scene::Scene scene() const;
  /// Memory of its pixels and classes.
  std::size_t bytes() const;

 private:
  struct Pixels {
    PackedTensor rgb, valid;
  };
  scene::Scene rest_;           ///< without what follows
  std::vector<Pixels> pixels_;  ///< by view
  PackedTensor classes_;
};

/// Scenes that are made up while a training runs.
class SceneStream : public Stream<KeptScene> {
 public:
  /// uses, pool  as `Stream`
  SceneStream(const scene::SimulateConfig& config, std::uint64_t seed, Index uses, Index pool);
};

/// Scene number `number` of those.
scene::Scene made_up_scene(scene::SimulateConfig config, std::uint64_t seed, Index number);

}  // namespace satsurf::train

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/scene/scene.h"
#include "satsurf/scene/simulate/scene.h"

#include <cstdint>
#include <future>
#include <map>
#include <memory>
#include <mutex>

namespace satsurf::train {

/// Scenes that are made up while a training runs, used for some samples and thrown away: no sample
/// number of files or gigabytes bounds what a network sees. Sample i is cut from one of the `pool`
/// scenes that end with number i / uses, so every scene is drawn `uses` times on average, spread
/// over pool x uses samples.
class SceneStream {
 public:
  /// uses  samples per scene, on average
  /// pool  scenes to draw from at any time
  SceneStream(const scene::SimulateConfig& config, std::uint64_t seed, Index uses, Index pool);

  /// The number of the first scene of those that a sample may be cut from; there are `pool()`.
  Index first(Index sample) const { return sample / uses_; }
  Index pool() const { return pool_; }
  /// A scene by its number: the same one whenever it is asked for, by any thread. It is made by the
  /// first who asks, on the threads that one has; scenes far behind are forgotten.
  std::shared_ptr<const scene::Scene> scene(Index number);

 private:
  using Made = std::shared_future<std::shared_ptr<const scene::Scene>>;

  scene::SimulateConfig config_;
  std::uint64_t seed_;
  Index uses_, pool_;
  std::mutex mutex_;
  std::map<Index, Made> scenes_;
};

}  // namespace satsurf::train

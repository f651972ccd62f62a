// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/packed_tensor.h"
#include "satsurf/core/rng.h"
#include "satsurf/nn/model.h"
#include "satsurf/nn/surface_net.h"
#include "satsurf/scene/simulate/scene.h"
#include "satsurf/train/training.h"

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

namespace satsurf::train {

/// What of the surface network learns.
enum class Learn {
  surface,  ///< its heights, and what errors it expects of them
  sigma     ///< the second network, that says better what errors to expect; the first one stays
};

}  // namespace satsurf::train

template <>
struct satsurf::EnumNames<satsurf::train::Learn> {
  static constexpr std::array names{"surface", "sigma"};
};

namespace satsurf::train {

/// Everything the training of the surface network depends on besides data and seed.
struct SurfaceTrainConfig : TrainingSettings {
  nn::SurfaceConfig surface;
  /// Weights of cascades whose reconstructions are refined, a random one of them in each scene: the
  /// network should see the errors of more than the best one. The files that are written have the
  /// first, too.
  std::vector<std::filesystem::path> cascades;
  Index batch = 4;                   ///< windows per step, each on a thread of its own
  Index views_most = 5;              ///< images of a reconstruction, which has two or more
  double range_jitter = 0.3;         ///< random widening of the height range, share of its span
  double distance_weight = 1;        ///< of the mean distance; that of the likelihood is 1
  double choice_weight = 0.3;        ///< of the cross-entropy of the candidates
  Learn learn = Learn::surface;      ///< what does
  double within_two = 2.24;          ///< Learn::sigma: `two` of `sigma_loss`
  scene::SimulateConfig simulate{};  ///< scenes made up on the way, where no data set is given
  Index scene_uses = 16;             ///< samples of each reconstruction
  Index scene_pool = 24;             ///< reconstructions to draw from at any time

  SurfaceTrainConfig() {
    task = Task::surface;
    crop = 192;
    lr = 2e-3;
    clip = 1;
    simulate.views = 5;
    simulate.bias_px = 0.5;
  }

  template <class Self, class V>
  static void fields(Self& s, V&& v) {
    TrainingSettings::fields(s, v);
    v("surface", s.surface, Field{.help = "surface network"});
    v("cascades", s.cascades,
      Field{.help =
                "weights of the networks whose surfaces are refined, one of them drawn for each "
                "scene; the files written have the first, too",
            .automatic = "the shipped ones",
            .placeholder = "FILE"});
    v("batch", s.batch,
      Field{.help = "windows per step, each on a thread of its own", .min = 1, .max = 64});
    v("views_most", s.views_most,
      Field{.help = "most images of a reconstruction; the least are two", .min = 2, .max = 16});
    v("range_jitter", s.range_jitter,
      Field{.help = "random widening of the height range", .min = 0, .max = 10});
    v("distance_weight", s.distance_weight,
      Field{.help = "weight of the mean distance from the truth; that of the likelihood is 1",
            .min = 0});
    v("choice_weight", s.choice_weight,
      Field{.help = "weight of the cross-entropy of the candidates", .min = 0});
    v("learn", s.learn,
      Field{.help = "surface: heights, and what errors to expect of them; sigma: the latter "
                    "alone, of a network that is finished (surface.sigma_hidden)"});
    v("within_two", s.within_two,
      Field{.help =
                "--learn sigma: gain of an error within twice the expected one, where one within "
                "the expected one costs 1; 2.24 is right for normal errors",
            .min = 1.01,
            .max = 100});
    v("simulate", s.simulate, Field{.help = "scenes made up on the way, without --data"});
    v("scene_uses", s.scene_uses,
      Field{.help = "samples of each reconstruction, on average", .min = 1, .max = 10000});
    v("scene_pool", s.scene_pool,
      Field{.help = "reconstructions to draw from at any time", .min = 1, .max = 1000});
  }
};

/// A surface before the network has looked at it, and what is true.
struct SurfaceLesson {
  nn::SurfaceInput input;
  Tensor truth;   ///< [H W] local m
  Tensor weight;  ///< [H W] 1 where the truth is known and counts, else 0
};

/// A reconstruction of some of a scene's images, two to `config.views_most`, by one of the cascades,
/// and what is true of it. Half of the lessons have cells of a pixel on the ground, as reconstructions
/// have by default, the others of half a pixel to one and a half: what users ask for, and where the
/// network would be at a loss that has seen nothing but one size.
/// scene    with a truth
SurfaceLesson surface_lesson(const SurfaceTrainConfig& config,
                             const std::vector<nn::Model>& cascades, scene::Scene scene, Rng rng);

/// Likelihood, distance and choice, in which the terms are `height_mae` and `mode_mae` (of the
/// densest mode, with the holes filled: what the network begins with), m.
StepLoss surface_loss(const SurfaceTrainConfig& config, const nn::SurfaceModel& network,
                      const SurfaceLesson& lesson);

/// A lesson in six tenths of its memory, for it is kept for many windows: its planes, which are of
/// order 1, in half precision.
class KeptLesson {
 public:
  explicit KeptLesson(const SurfaceLesson& lesson);
  /// A random square in one of eight orientations; the whole of it along axes on which it is smaller.
  SurfaceLesson window(Index size, Rng& rng) const;
  /// Memory of its maps.
  std::size_t bytes() const;

 private:
  PackedTensor candidates_, planes_, truth_, weight_;
  double interval_;
};

/// Trains the surface network on reconstructions of a folder's scenes, or of scenes that are made up
/// on the way; arguments as those of the cascade's `train`.
/// throws  IoError, ConfigError
nn::SurfaceModel train(const SurfaceTrainConfig& config, const std::filesystem::path& data,
                       std::uint64_t seed, const std::filesystem::path& checkpoint,
                       const TrainingCallbacks& callbacks);

}  // namespace satsurf::train

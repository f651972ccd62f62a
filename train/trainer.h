// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/model.h"
#include "satsurf/scene/simulate/scene.h"
#include "satsurf/train/augment.h"
#include "satsurf/train/loss.h"
#include "satsurf/train/scene_stream.h"
#include "satsurf/train/training.h"

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

namespace satsurf::train {

/// Everything the training of the cascade depends on besides data and seed.
struct TrainConfig : TrainingSettings, LossConfig, AugmentConfig {
  // That of the losses would compare those alone.
  friend bool operator==(const TrainConfig&, const TrainConfig&) = delete;

  std::string preset = "base8";  ///< starting point of `model` and of the losses
  nn::ModelConfig model;
  std::filesystem::path mono_weights;  ///< of the monocular branch, from `--task mono`; see `train`
  std::filesystem::path mono_found;    ///< the file where that is empty; no field, not recorded
  Index views = 3;                     ///< source views per sample; one more is the target
  Index batch = 1;                     ///< samples per step, each on a thread of its own
  double range_jitter = 0.2;           ///< random widening of the height range, share of its span
  double radiometry_views = 0;         ///< as `radiometry`, of every view by itself
  scene::SimulateConfig simulate{};    ///< scenes made up on the way, where no data set is given
  Index scene_uses = 12;               ///< samples of each of those
  Index scene_pool = 24;               ///< of them to draw from at any time

  template <class Self, class V>
  static void fields(Self& s, V&& v) {
    v("preset", s.preset,
      Field{.help = "what the fields of network and losses start from",
            .choices = nn::model_preset_names()});
    TrainingSettings::fields(s, v);
    LossConfig::fields(s, v);
    v("model", s.model, Field{.help = "network"});
    v("mono_weights", s.mono_weights,
      Field{.help = "trained monocular branch",
            .automatic = "the shipped one",
            .flag = "--mono_weights,--mono-weights"});
    v("views", s.views, Field{.help = "source views per sample", .min = 2, .max = 8});
    v("batch", s.batch,
      Field{.help = "samples per step, each on a thread of its own", .min = 1, .max = 64});
    v("range_jitter", s.range_jitter,
      Field{.help = "random widening of the height range", .min = 0, .max = 2});
    AugmentConfig::fields(s, v);
    v("radiometry_views", s.radiometry_views,
      Field{.help = "random gain, offset and gamma of every view by itself", .min = 0, .max = 0.9});
    v("simulate", s.simulate, Field{.help = "scenes made up on the way, without --data"});
    v("scene_uses", s.scene_uses,
      Field{.help = "samples of each of them, on average", .min = 1, .max = 10000});
    v("scene_pool", s.scene_pool,
      Field{.help = "of them to draw from at any time", .min = 1, .max = 1000});
  }
};

/// Whether the network has a monocular branch that `init` does not bring.
/// throws  IoError if `init` cannot be read
bool needs_branch(const TrainConfig& config);

/// What of a configuration has no effect, in sentences for the user: losses whose network or target
/// is missing, weights of a branch that the network does not have.
std::vector<std::string> idle_settings(const TrainConfig& config);

/// Sample number `sample` of a run, from 0, of which every step takes `batch`: windows of one place, all of one size, with what is known
/// of its surface. It depends on nothing else, for it may be asked for again: by an interrupted run
/// that goes on, or to find what made a loss infinite. May throw to stop.
using SampleSource = std::function<scene::Crop(Index sample)>;

/// Trains a network on samples of one's own.
/// model      in training from its present parameters, or from what `init` or a checkpoint has; a
///            monocular branch stays as it is
/// config     objective and optimiser; that of the network is the model's. What else concerns the
///            making of networks and samples is not read: `preset`, `mono_weights`, `crop`, `views`,
///            `range_jitter`, `radiometry`, `grey_share`
/// sample     called for every sample, by several threads at once if `batch` is more than one
/// callbacks  what the caller is told; without `save` nothing is kept (see `keep_in`)
/// throws     IoError, ConfigError; ShapeError if the samples do not fit the network; Error if a
///            loss is not finite
void train_on_samples(nn::Model& model, const TrainConfig& config, const SampleSource& sample,
                      const TrainingRun& run = {}, const TrainingCallbacks& callbacks = {});

/// Trains a new network on the scenes of a folder: `train_on_samples` of `training_sample`.
/// config      all settings
/// data        data set, see `scene::list_scenes`; empty: scenes are made up (`SceneStream`)
/// seed        of the initial weights and the samples
/// checkpoint  go on from this file, bit for bit as if never interrupted; empty for a new run
/// callbacks   what the caller is told; without `save` nothing is kept
/// returns     the network as it is when the steps are done or `step` says stop
/// throws      IoError, ConfigError; also where the model has a monocular branch and none of
///             `init`, `mono_weights` and `mono_found` names a file that has it, for it is not
///             trained here, and where both `init` and `mono_weights` do
nn::Model train(const TrainConfig& config, const std::filesystem::path& data, std::uint64_t seed,
                const std::filesystem::path& checkpoint, const TrainingCallbacks& callbacks);

/// Sample number `sample` of a run: a pure function of scenes, configuration, seed and number.
scene::Crop training_sample(const TrainConfig& config, const std::vector<scene::Scene>& scenes,
                            std::uint64_t seed, Index sample);
/// The same from scenes that are made up on the way.
scene::Crop training_sample(const TrainConfig& config, SceneStream& scenes, std::uint64_t seed,
                            Index sample);

}  // namespace satsurf::train

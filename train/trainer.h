// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/model.h"
#include "satsurf/nn/weights_file.h"
#include "satsurf/train/loss.h"
#include "satsurf/train/training.h"

#include <filesystem>
#include <functional>
#include <map>
#include <string>
#include <vector>

namespace satsurf::train {

/// Everything the training of the surface network depends on besides data and seed.
struct TrainConfig : TrainingSettings, LossConfig {
  std::string preset = "base8";  ///< starting point of `model` and of the losses
  nn::ModelConfig model;
  std::string mono_weights;   ///< of the monocular branch, from `--task mono`; see `train`
  std::string mono_found;     ///< the file where `mono_weights` is empty; no field, not recorded
  Index views = 3;            ///< source views per sample; one more is the target
  double range_jitter = 0.2;  ///< random widening of the height range, share of its span

  template <class Self, class V>
  static void fields(Self& s, V&& v) {
    v("preset", s.preset,
      Field{.help = "what the fields of network and losses start from",
            .choices = nn::model_preset_names()});
    TrainingSettings::fields(s, v);
    LossConfig::fields(s, v);
    v("model", s.model, Field{.help = "network"});
    v("mono_weights", s.mono_weights,
      Field{.help = "trained monocular branch; empty for the shipped one"});
    v("views", s.views, Field{.help = "source views per sample", .min = 2, .max = 8});
    v("range_jitter", s.range_jitter,
      Field{.help = "random widening of the height range", .min = 0, .max = 2});
  }
};

/// Whether the network has a monocular branch that `init` does not bring.
/// throws  IoError if `init` cannot be read
bool needs_branch(const TrainConfig& config);

/// What of a configuration has no effect, in sentences for the user: losses whose network or target
/// is missing, weights of a branch that the network does not have.
std::vector<std::string> idle_settings(const TrainConfig& config);

/// Trains on the scenes of a folder.
/// config      all settings
/// data        data set, see `scene::list_scenes`
/// seed        of the initial weights and the samples
/// checkpoint  go on from this file, bit for bit as if never interrupted; empty for a new run
/// callbacks   what the caller is told; without `save` nothing is kept
/// throws      IoError, ConfigError; also where the model has a monocular branch and none of
///             `init`, `mono_weights` and `mono_found` names a file that has it, for it is not
///             trained here, and where both `init` and `mono_weights` do
void train(const TrainConfig& config, const std::filesystem::path& data, std::uint64_t seed,
           const std::filesystem::path& checkpoint, const TrainingCallbacks& callbacks);

/// Sample number `step` of a run: a pure function of scenes, configuration, seed and step.
scene::Crop training_sample(const TrainConfig& config, const std::vector<scene::Scene>& scenes,
                            std::uint64_t seed, Index step);

}  // namespace satsurf::train

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/model.h"
#include "satsurf/train/loss.h"
#include "satsurf/train/training.h"

#include <filesystem>
#include <functional>
#include <map>
#include <string>

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
            .choices = {"tiny", "tiny_full", "base8", "base16", "cascade8", "paper", "mvsplat_like",
                        "hisplat_like", "skysplat_like"}});
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

/// Trains on the scenes of a folder and writes `checkpoint.safetensors` (all that resuming needs),
/// `weights.safetensors` (the model alone) and `train.jsonl`.
/// config    all settings
/// data      data set, see `list_scenes`
/// out       folder of the files; a staged one is committed with the first checkpoint, after one
///           step: what fails before costs no earlier run
/// seed      of the initial weights and the samples
/// resume    go on from `out/checkpoint.safetensors`, bit for bit as if never interrupted
/// callback  may be empty
/// reading   told before each scene is read which share of them has been; may throw to stop
/// throws    IoError, ConfigError; also where the model has a monocular branch and neither `init`
///           nor `mono_weights` names a file that has it: it is not trained here
void train(const TrainConfig& config, const std::filesystem::path& data, OutputFolder out,
           std::uint64_t seed, bool resume, const StepCallback& callback,
           const std::function<void(double)>& reading = {});

/// A model from a weights or checkpoint file, which carries its configuration.
/// throws  IoError
nn::Model load_model(const std::filesystem::path& path);
/// Writes the model alone, whole or not at all.
/// origin  further metadata: where the weights come from. `train` writes `train` (the configuration
///         of the run, other files by name), `seed`, `step` (those done), `scenes` (trained on),
///         `version` and `git`
/// throws  IoError
void save_model(const std::filesystem::path& path, const nn::Model& model,
                const std::map<std::string, std::string>& origin = {});

/// Puts a trained monocular network into a model's branch.
/// throws  IoError if the file holds none, or one of another configuration
void load_mono_branch(nn::Model& model, const std::filesystem::path& path);

/// Before the names of a model's parameters in a file.
constexpr const char* kModelPrefix = "model.";

/// Adds a model to a file that holds more: tensors `model.*`, metadata `format` and `model` (its
/// configuration).
void store_model(TensorFile& file, const nn::Model& model);
/// The model in a file that `store_model` filled; `where` begins the error texts.
/// throws  IoError
nn::Model model_from(const TensorFile& file, const std::string& where);

/// Sample number `step` of a run: a pure function of scenes, configuration, seed and step.
Crop training_sample(const TrainConfig& config, const std::vector<Scene>& scenes,
                     std::uint64_t seed, Index step);

}  // namespace satsurf::train

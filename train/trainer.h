// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/adamw.h"
#include "satsurf/nn/model.h"
#include "satsurf/train/dataset.h"
#include "satsurf/train/loss.h"
#include "satsurf/train/output_folder.h"

#include <filesystem>
#include <functional>
#include <map>
#include <string>

namespace satsurf::train {

/// Everything a training run depends on besides data and seed.
struct TrainConfig : LossConfig {
  std::string preset = "base8";  ///< starting point of `model`
  nn::ModelConfig model;
  std::string init;  ///< weights file to start from, or empty for random weights
  Index steps = 4000;
  Index views = 3;   ///< source views per sample; one more is the target
  Index crop = 128;  ///< window side, px
  double lr = 1e-3;
  double warmup = 0.03;  ///< share of the steps
  double weight_decay = 0.01;
  double clip = 0.5;             ///< global gradient norm
  double range_jitter = 0.2;     ///< random widening of the height range, share of its span
  double grey_share = 0.4;       ///< share of the samples made panchromatic
  double radiometry = 0.15;      ///< random gain, offset and gamma of a sample
  Index checkpoint_every = 200;  ///< steps

  template <class Self, class V>
  static void fields(Self& s, V&& v) {
    LossConfig::fields(s, v);
    v("preset", s.preset,
      Field{.help = "what the fields of network and losses start from",
            .choices = {"tiny", "tiny_full", "base8", "base16", "cascade8", "paper", "mvsplat_like",
                        "hisplat_like", "skysplat_like"}});
    v("model", s.model, Field{.help = "network"});
    v("init", s.init, Field{.help = "weights to start from instead of random ones"});
    v("steps", s.steps, Field{.help = "optimiser steps", .min = 1});
    v("views", s.views, Field{.help = "source views per sample", .min = 2, .max = 8});
    v("crop", s.crop, Field{.help = "side of the training windows", .unit = "px", .min = 8});
    v("lr", s.lr, Field{.help = "peak learning rate", .min = 0, .max = 1});
    v("warmup", s.warmup, Field{.help = "share of the steps before the peak", .min = 0, .max = 1});
    v("weight_decay", s.weight_decay, Field{.help = "decoupled weight decay", .min = 0, .max = 1});
    v("clip", s.clip, Field{.help = "largest global gradient norm", .min = 0});
    v("range_jitter", s.range_jitter,
      Field{.help = "random widening of the height range", .min = 0, .max = 2});
    v("grey_share", s.grey_share,
      Field{.help = "share of the samples made panchromatic", .min = 0, .max = 1});
    v("radiometry", s.radiometry,
      Field{.help = "random gain, offset and gamma of a sample", .min = 0, .max = 0.9});
    v("checkpoint_every", s.checkpoint_every, Field{.help = "steps between checkpoints", .min = 1});
  }
};

/// One line of `train.jsonl`.
struct StepReport {
  Index step = 0, steps = 0;  ///< this one, from 1, and how many there will be
  /// The objective and its numbers (see LossReport), learning rate, norm before clipping, time.
  double loss = 0, height_mae = 0, colour_psnr = 0, lr = 0, grad_norm = 0, seconds = 0;
};

/// Called after every step; returning false stops after saving a checkpoint.
using StepCallback = std::function<bool(const StepReport&)>;

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
/// throws    IoError, ConfigError
void train(const TrainConfig& config, const std::filesystem::path& data, OutputFolder out,
           std::uint64_t seed, bool resume, const StepCallback& callback,
           const std::function<void(double)>& reading = {});

/// A model from a weights or checkpoint file, which carries its configuration.
/// throws  IoError
nn::Model load_model(const std::filesystem::path& path);
/// Writes the model alone, whole or not at all.
/// origin  further metadata: where the weights come from. `train` writes `train` (the configuration
///         of the run), `seed`, `step` (those done), `scenes` (trained on), `version` and `git`
/// throws  IoError
void save_model(const std::filesystem::path& path, const nn::Model& model,
                const std::map<std::string, std::string>& origin = {});

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

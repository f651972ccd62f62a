// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/fields.h"
#include "satsurf/core/safetensors.h"
#include "satsurf/nn/module.h"
#include "satsurf/scene/crop.h"
#include "satsurf/scene/dataset.h"

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <functional>
#include <string>
#include <utility>
#include <vector>

namespace satsurf::train {

/// Which network is trained.
enum class Task {
  cascade,  ///< the one that makes heights and surfels of two or more images
  mono,     ///< the one that sees relative heights in a single image
  surface   ///< the one that makes one surface of what the cascade found in all images
};

}  // namespace satsurf::train

template <>
struct satsurf::EnumNames<satsurf::train::Task> {
  static constexpr std::array names{"cascade", "mono", "surface"};
};

namespace satsurf::train {

/// How the learning rate goes on after its rise.
enum class Schedule {
  one_cycle,  ///< down to nothing at the last step
  constant    ///< at its peak, for runs that end when there is no more time: average the weights
};

}  // namespace satsurf::train

template <>
struct satsurf::EnumNames<satsurf::train::Schedule> {
  static constexpr std::array names{"one_cycle", "constant"};
};

namespace satsurf::train {

/// What every training run has, whatever network it trains.
struct TrainingSettings {
  Task task = Task::cascade;
  std::filesystem::path
      init;  ///< weights to start from, of all or parts of the network; empty for none
  Index steps = 4000;
  Index crop = 128;  ///< window side, px
  double lr = 1e-3;
  double warmup = 0.03;  ///< share of the steps
  Schedule schedule = Schedule::one_cycle;
  double average = 0;  ///< what the averaged weights keep from step to step; 0 averages nothing
  double weight_decay = 0.01;
  double clip = 0.5;             ///< global gradient norm
  Index checkpoint_every = 200;  ///< steps
  bool half = false;             ///< weights in half precision

  template <class Self, class V>
  static void fields(Self& s, V&& v) {
    v("task", s.task,
      Field{.help = "network to train: the one that makes heights and surfels of two or more "
                    "images, the one that sees relative heights in a single image, or the one "
                    "that makes one surface of what the first found in all images"});
    v("init", s.init,
      Field{.help = "weights to start from instead of random ones; parts of the network that "
                    "the file lacks start as without it"});
    v("steps", s.steps, Field{.help = "optimiser steps", .min = 1});
    v("crop", s.crop, Field{.help = "side of the training windows", .unit = "px", .min = 8});
    v("lr", s.lr, Field{.help = "peak learning rate", .min = 0, .max = 1});
    v("warmup", s.warmup, Field{.help = "share of the steps before the peak", .min = 0, .max = 1});
    v("schedule", s.schedule, Field{.help = "learning rate after its rise"});
    v("average", s.average,
      Field{.help = "what the running mean of the weights keeps from step to step; it is what "
                    "weights.safetensors has. 0: the weights of the last step",
            .min = 0,
            .max = 0.99999});
    v("weight_decay", s.weight_decay, Field{.help = "decoupled weight decay", .min = 0, .max = 1});
    v("clip", s.clip, Field{.help = "largest global gradient norm", .min = 0});
    v("checkpoint_every", s.checkpoint_every, Field{.help = "steps between checkpoints", .min = 1});
    v("half", s.half,
      Field{.help = "write weights.safetensors in half precision, at half the size"});
  }
};

/// The objective of a sample or a step, and what it says in numbers.
struct StepLoss {
  Var total;                                          ///< scalar
  std::vector<std::pair<std::string, double>> terms;  ///< as `train.jsonl` names them; may be NaN
};

/// One line of `train.jsonl`.
struct StepReport {
  Index step = 0, steps = 0;  ///< this one, from 1, and how many there will be
  /// The objective, learning rate, norm before clipping, time.
  double loss = 0, lr = 0, grad_norm = 0, seconds = 0;
  std::vector<std::pair<std::string, double>> terms{};  ///< of the objective

  /// NaN if there is none of that name.
  double term(const std::string& name) const;
};

/// What a training tells its caller, and what it asks of it. Each may be empty.
struct TrainingCallbacks {
  /// After every step; returning false stops the training once its state has been saved.
  std::function<bool(const StepReport&)> step;
  /// Whenever the state is worth keeping: after the first step of a new run, before the first of one
  /// that is resumed, every `checkpoint_every` steps and at the end. The checkpoint holds all that resuming needs, the
  /// weights the network alone.
  std::function<void(const TensorFile& checkpoint, const TensorFile& weights)> save;
  /// Before each scene is read, with the share of them that has been; may throw to stop.
  std::function<void(double)> reading;
  /// A finding in a sentence for the user.
  std::function<void(const std::string&)> note;
};

/// A network in training, and what it is taught.
class TrainingTask {
 public:
  virtual ~TrainingTask() = default;
  virtual nn::ParameterSet<float>& parameters() = 0;
  /// Before the name of every parameter in a file.
  virtual std::string prefix() const = 0;
  /// Adds the network to a file: its configuration and its parameters under `prefix()`.
  virtual void store(TensorFile& file) const = 0;
  /// Samples of a step.
  virtual Index batch() const { return 1; }
  /// The objective of sample number `sample`, from 0, with the parameters as they are: a pure
  /// function of both.
  virtual StepLoss loss(Index sample) const = 0;
  /// The objective of step number `step`, from 0, the mean of its samples'; its gradient is left
  /// with the parameters, which have none before, unless the objective is not finite.
  virtual StepLoss descend(Index step);
};

/// What a run is, besides its network, settings and samples.
struct TrainingRun {
  std::uint64_t seed = 0;              ///< of the initial weights and of all that is drawn
  std::filesystem::path checkpoint{};  ///< to go on from, bit for bit; empty for a new run
  std::size_t scenes = 0;              ///< trained on, for the files to tell
  /// What tells the samples from others, see `data_mark`, which a checkpoint keeps and resuming compares;
  /// empty where nobody knows.
  std::string data{};
};

/// Refuses windows that the memory cannot hold with the smallest network, before anything is read.
/// views   images that a window is cut from
/// throws  Error
void check_crop_memory(const TrainingSettings& settings, Index views);

/// Optimises a network with AdamW and a learning rate that goes as `schedule` says.
/// task      the network and its objective
/// settings  of the run
/// config    all settings as JSON, which the files keep and resuming compares
/// throws    IoError, ConfigError; Error if loss or gradient is not finite
void run_training(TrainingTask& task, const TrainingSettings& settings, const std::string& config,
                  const TrainingRun& run, const TrainingCallbacks& callbacks);

/// The files of a run in a folder: `checkpoint.safetensors` (all that resuming needs),
/// `weights.safetensors` (the network alone) and `train.jsonl` (a line per step).
class TrainingFolder {
 public:
  explicit TrainingFolder(std::filesystem::path folder) : folder_(std::move(folder)) {}

  std::filesystem::path checkpoint() const { return folder_ / "checkpoint.safetensors"; }
  /// Adds the step's line to `train.jsonl`; the first call drops the lines of that step and later
  /// ones, which an interrupted run may have left, and those that were cut short.
  /// throws  IoError
  void add(const StepReport& report);
  /// throws  IoError
  void save(const TensorFile& checkpoint, const TensorFile& weights) const;
  /// The folder has been renamed.
  void moved_to(std::filesystem::path folder) { folder_ = std::move(folder); }

 private:
  std::filesystem::path folder_;
  std::ofstream lines_;
};

/// Callbacks that keep a training's files in a folder (`TrainingFolder`), which is made if there is
/// none.
/// step    told of every step once its line is written; returning false stops. May be empty
/// throws  IoError
TrainingCallbacks keep_in(const std::filesystem::path& folder,
                          std::function<bool(const StepReport&)> step = {});

/// All scenes of a data set, each with the truth.
/// least    images of each
/// reading  told before each scene is read which share of them has been; may throw to stop
/// what     they are for, to end the complaint of a scene that has fewer
/// throws   IoError
std::vector<scene::Scene> training_scenes(const std::filesystem::path& folder, Index least,
                                          const std::function<void(double)>& reading,
                                          const std::string& what = {});

/// What tells a data set from others: how many scenes there are, and a hash of their names, images'
/// names and sizes, and true heights.
std::string data_mark(const std::vector<scene::Scene>& scenes);
/// That of scenes made up on the way, of which configuration and seed tell the rest.
inline constexpr const char* kMadeUp = "scenes made up on the way";

}  // namespace satsurf::train

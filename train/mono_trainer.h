// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/mono.h"
#include "satsurf/train/augment.h"
#include "satsurf/train/training.h"

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

namespace satsurf::train {

/// Everything the training of the monocular network depends on besides data and seed.
struct MonoTrainConfig : TrainingSettings, AugmentConfig {
  nn::MonoConfig mono;
  Index batch = 2;               ///< windows per step
  double gradient_weight = 0.5;  ///< of the gradient loss; that of the distance is 1
  /// Mean absolute deviation of a window's true heights below which it teaches nothing, m: it is
  /// drawn anew.
  double least_relief = 0.5;

  MonoTrainConfig() {
    task = Task::mono;
    crop = 256;  // the network sees 400 px
    lr = 2e-3;
    clip = 1;
  }

  template <class Self, class V>
  static void fields(Self& s, V&& v) {
    TrainingSettings::fields(s, v);
    v("mono", s.mono, Field{.help = "monocular network"});
    v("batch", s.batch, Field{.help = "windows per step", .min = 1, .max = 64});
    AugmentConfig::fields(s, v);
    v("gradient_weight", s.gradient_weight,
      Field{.help = "weight of the gradient loss of relative heights", .min = 0});
    v("least_relief", s.least_relief,
      Field{.help = "deviation of true heights below which a window is drawn anew",
            .unit = "m",
            .min = 0});
  }
};

/// Windows of single images, and what is true of them.
struct MonoSample {
  Tensor image;  ///< [N 3 S S], each standardised
  Tensor truth;  ///< [N S S] m; NaN where unknown
  Tensor valid;  ///< [N S S] 1 where image and height are known, else 0
};

/// Sample number `step` of a run: a pure function of scenes, configuration, seed and step. A window
/// of a random view each, in one of eight orientations: relative heights know no camera.
MonoSample mono_sample(const MonoTrainConfig& config, const std::vector<scene::Scene>& scenes,
                       std::uint64_t seed, Index step);

/// Scale-and-shift-invariant distance plus weighted gradients, in which the maps' terms are `ssi`,
/// `gradient` and `correlation` (see `mono_correlation`).
StepLoss mono_loss(const MonoTrainConfig& config, const nn::Mono& mono, const MonoSample& sample);

/// Pearson correlation of relative heights with true ones over valid pixels, on average over the
/// maps in which both vary; NaN without any.
/// height, truth, valid  [N H W]
/// throws                ShapeError
double mono_correlation(const Tensor& height, const Tensor& truth, const Tensor& valid);

/// Trains the monocular network on the views of a folder's scenes; arguments as those of the
/// cascade's `train`. Terms of a step: `ssi`, `gradient`, `correlation`.
/// throws  IoError, ConfigError
nn::Mono train(const MonoTrainConfig& config, const std::filesystem::path& data, std::uint64_t seed,
               const std::filesystem::path& checkpoint, const TrainingCallbacks& callbacks);

}  // namespace satsurf::train

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/train/mono_trainer.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/fields_json.h"
#include "satsurf/core/symmetry.h"
#include "satsurf/nn/weights_file.h"
#include "satsurf/ops/elementwise.h"
#include "satsurf/ops/ssi_loss.h"
#include "satsurf/train/augment.h"
#include "satsurf/train/draw.h"

#include <algorithm>
#include <cmath>

namespace satsurf::train {
namespace {

namespace fs = std::filesystem;

/// Two-pass moments of the valid pixels of one map.
struct Moments {
  double n = 0, x = 0, y = 0, xx = 0, xy = 0, yy = 0;  ///< number, means, mean products

  Moments(const float* a, const float* b, const float* valid, Index count) {
    const auto each = [&](const auto& body) {
      for (Index i = 0; i < count; ++i)
        if (valid[i] != 0) body(static_cast<double>(a[i]), static_cast<double>(b[i]));
    };
    each([&](double u, double v) { n += 1, x += u, y += v; });
    if (n == 0) return;
    x /= n, y /= n;
    each([&](double u, double v) {
      xx += (u - x) * (u - x) / n, xy += (u - x) * (v - y) / n, yy += (v - y) * (v - y) / n;
    });
  }
};

/// One window: [1 3 S S], [S S] and [S S].
MonoSample window(const MonoTrainConfig& config, const std::vector<scene::Scene>& scenes,
                  Rng& rng) {
  // A window may lie where the truth is unknown or flat; a few tries find a good one, and the loss
  // leaves out what is flat after all.
  constexpr int kTries = 20;
  constexpr double kEnough = 0.6;  // share of pixels with a known height
  nn::PosedImage view;
  Tensor truth, valid;
  for (int attempt = 0; attempt < kTries; ++attempt) {
    const scene::Scene& scene =
        scenes[static_cast<std::size_t>(rng.below(static_cast<Index>(scenes.size())))];
    const Index number = rng.below(static_cast<Index>(scene.views.size()));
    const scene::View& from = scene.views[static_cast<std::size_t>(number)];
    const double px = window_middle(config.crop, from.rgb.dim(2), rng),
                 py = window_middle(config.crop, from.rgb.dim(1), rng);
    const double z = scene.z_range.middle();  // any: it is this view's own pixel
    const auto at =
        scene.frame.local_from_geodetic(from.rpc.localize({px, py}, z + scene.frame.h0));
    scene::Crop crop = scene::make_crop(scene, {.sources = {number},
                                                .centre = {at[0], at[1], z},
                                                .size = {config.crop, config.crop},
                                                .z_range = scene.z_range,
                                                .with_truth = true});
    view = std::move(crop.input.sources[0]);
    truth = std::move(crop.source_truth[2][0]);
    valid = Tensor(truth.shape());
    for (Index i = 0; i < truth.count(); ++i)
      valid[i] = view.valid[i] > 0 && std::isfinite(truth[i]) ? 1.f : 0.f;
    const Moments m(truth.data(), truth.data(), valid.data(), truth.count());
    if (m.n >= kEnough * static_cast<double>(truth.count()) &&
        std::sqrt(m.xx) > config.least_relief)
      break;
  }
  apply(random_radiometry(config.radiometry, config.grey_share, rng), view);
  const Index symmetry = rng.below(kSymmetries);
  view.rgb = turned(view.rgb, symmetry);
  view.valid = turned(view.valid, symmetry);
  return {nn::standardised<float>(view), turned(truth, symmetry), turned(valid, symmetry)};
}

/// The monocular network and its objective.
class MonoTask : public TrainingTask {
 public:
  MonoTask(nn::Mono& mono, const MonoTrainConfig& config, const std::vector<scene::Scene>& scenes,
           std::uint64_t seed)
      : mono_(mono), config_(config), scenes_(scenes), seed_(seed) {}

  nn::ParameterSet<float>& parameters() override { return mono_.parameters(); }
  std::string prefix() const override { return nn::kMonoPrefix; }
  void store(TensorFile& file) const override { nn::store_mono(file, mono_); }
  StepLoss loss(Index step) const override {
    return mono_loss(config_, mono_, mono_sample(config_, scenes_, seed_, step));
  }

 private:
  nn::Mono& mono_;
  const MonoTrainConfig& config_;
  const std::vector<scene::Scene>& scenes_;
  std::uint64_t seed_;
};

}  // namespace

MonoSample mono_sample(const MonoTrainConfig& config, const std::vector<scene::Scene>& scenes,
                       std::uint64_t seed, Index step) {
  const Index N = config.batch, S = config.crop;
  const Rng of_step = Rng(seed).fork(static_cast<std::uint64_t>(step));
  MonoSample sample{Tensor({N, 3, S, S}), Tensor({N, S, S}), Tensor({N, S, S})};
  for (Index n = 0; n < N; ++n) {
    Rng rng = of_step.fork(static_cast<std::uint64_t>(n));
    const MonoSample one = window(config, scenes, rng);
    std::ranges::copy(one.image.values(), sample.image.data() + n * 3 * S * S);
    std::ranges::copy(one.truth.values(), sample.truth.data() + n * S * S);
    std::ranges::copy(one.valid.values(), sample.valid.data() + n * S * S);
  }
  return sample;
}

StepLoss mono_loss(const MonoTrainConfig& config, const nn::Mono& mono, const MonoSample& sample) {
  const Var height = mono(Var(sample.image)).height;
  const auto loss = ssi_loss(height, sample.truth, sample.valid, {.flat = config.least_relief});
  const auto number = [](const Var& v) { return static_cast<double>(v.value().item()); };
  return {loss.distance + affine(loss.gradient, static_cast<float>(config.gradient_weight), 0.f),
          {{"ssi", number(loss.distance)},
           {"gradient", number(loss.gradient)},
           {"correlation", mono_correlation(height.value(), sample.truth, sample.valid)}}};
}

double mono_correlation(const Tensor& height, const Tensor& truth, const Tensor& valid) {
  Dims dim("mono_correlation");
  dim.match("height", height, "N H W")
      .match("truth", truth, "N H W")
      .match("valid", valid, "N H W");
  const Index P = dim["H"] * dim["W"];
  double sum = 0, maps = 0;
  for (Index i = 0; i < dim["N"] * P; i += P) {
    const Moments m(height.data() + i, truth.data() + i, valid.data() + i, P);
    const double spread = std::sqrt(m.xx * m.yy);
    if (!(spread > 0)) continue;
    sum += m.xy / spread;
    maps += 1;
  }
  return maps > 0 ? sum / maps : std::nan("");
}

nn::Mono train(const MonoTrainConfig& config, const fs::path& data, std::uint64_t seed,
               const fs::path& checkpoint, const TrainingCallbacks& callbacks) {
  check_fields(config, "train");
  if (config.task != Task::mono)
    throw ConfigError("train: task is " + enum_name(config.task) + ", expected mono");
  if (config.crop % nn::kMonoMultiple != 0)
    throw ConfigError("train: crop is " + std::to_string(config.crop) +
                      ", expected a multiple of " + std::to_string(nn::kMonoMultiple));
  check_crop_memory(config, 1);
  const auto scenes = training_scenes(data, 1, callbacks.reading);
  nn::Mono mono(config.mono, seed);
  MonoTask task(mono, config, scenes, seed);
  run_training(
      task, config, to_json(config).dump(),
      {.seed = seed, .checkpoint = checkpoint, .scenes = scenes.size(), .data = data_mark(scenes)},
      callbacks);
  return mono;
}

}  // namespace satsurf::train

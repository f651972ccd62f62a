// SPDX-License-Identifier: Apache-2.0
#include "satsurf/train/trainer.h"

#include "satsurf/core/fields_json.h"
#include "satsurf/core/parallel.h"
#include "satsurf/nn/weights_file.h"
#include "satsurf/train/augment.h"
#include "satsurf/train/draw.h"
#include "satsurf/train/loss.h"
#include "satsurf/train/sample_batch.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <optional>

namespace satsurf::train {
namespace {

namespace fs = std::filesystem;

/// The cascade and its objective.
class CascadeTask : public TrainingTask {
 public:
  CascadeTask(nn::Model& model, const TrainConfig& config, const SampleSource& sample,
              std::uint64_t seed)
      : model_(model), config_(config), sample_(sample), seed_(seed) {
    if (!config.lpips_weights.empty()) lpips_ = nn::Lpips::load(config.lpips_weights);
    if (config.batch > 1) batch_.emplace(model, config.batch, seed);
  }

  nn::ParameterSet<float>& parameters() override { return model_.parameters(); }
  std::string prefix() const override { return nn::kModelPrefix; }
  void store(TensorFile& file) const override { nn::store_model(file, model_); }
  Index batch() const override { return config_.batch; }
  StepLoss loss(Index sample) const override { return loss(model_, sample); }

  StepLoss descend(Index step) override {
    if (!batch_) return TrainingTask::descend(step);
    return batch_->descend(
        step, [this](const nn::Model& model, Index sample) { return loss(model, sample); });
  }

 private:
  StepLoss loss(const nn::Model& model, Index sample) const {
    const scene::Crop crop = sample_(sample);
    const LossReport loss = training_loss(
        config_, model.config(),
        model.forward(crop.input, {}, nullptr, wanted_by(config_, crop.target.has_value())), crop,
        {.step = sample / config_.batch, .seed = seed_, .lpips = lpips_ ? &*lpips_ : nullptr});
    return {loss.total,
            {{"height_mae", loss.height_mae},
             {"colour_psnr", loss.colour_psnr},
             {"confident", loss.confident}}};
  }

  nn::Model& model_;
  const TrainConfig& config_;
  const SampleSource& sample_;
  std::uint64_t seed_;
  std::optional<nn::Lpips> lpips_;
  std::optional<SampleBatch<nn::Model>> batch_;
};

/// A random one of the scenes that a sample may be cut from.
using DrawScene = std::function<std::shared_ptr<const scene::Scene>(Rng&)>;

scene::Crop cut_sample(const TrainConfig& config, const DrawScene& draw, std::uint64_t seed,
                       Index sample) {
  Rng rng = Rng(seed).fork(static_cast<std::uint64_t>(sample));
  // A window may lie where the truth is unknown or outside an image; a few tries always find a good
  // one.
  constexpr int kTries = 20;
  constexpr double kEnough = 0.6;  // share of source pixels with a known height
  scene::Crop crop;
  for (int attempt = 0; attempt < kTries; ++attempt) {
    const std::shared_ptr<const scene::Scene> drawn = draw(rng);
    const scene::Scene& scene = *drawn;
    const std::vector<Index> order = shuffled(std::ssize(scene.views), rng);
    const auto N = static_cast<std::size_t>(config.views);
    const std::vector<Index> sources(order.begin(), order.begin() + static_cast<std::ptrdiff_t>(N));

    // Around a random pixel of the first source.
    const scene::HeightField& truth = *scene.truth;
    const scene::View& first = scene.views[static_cast<std::size_t>(sources[0])];
    const double px = window_middle(config.crop, first.rgb.dim(2), rng),
                 py = window_middle(config.crop, first.rgb.dim(1), rng);
    double x = 0, y = 0, z = scene.z_range.middle();
    for (int pass = 0; pass < 2;
         ++pass) {  // at the middle of the range first, then near the surface found there
      const auto p =
          scene.frame.local_from_geodetic(first.rpc.localize({px, py}, z + scene.frame.h0));
      x = p[0];
      y = p[1];
      const Index row = std::clamp<Index>(static_cast<Index>((truth.y0 - y) / truth.step), 0,
                                          truth.z.dim(0) - 1),
                  col = std::clamp<Index>(static_cast<Index>((x - truth.x0) / truth.step), 0,
                                          truth.z.dim(1) - 1);
      if (const float t = truth.z[row * truth.z.dim(1) + col]; std::isfinite(t))
        z = static_cast<double>(t);
    }
    const double span = scene.z_range.span();
    const double low = scene.z_range.low - rng.uniform(0, config.range_jitter) * span,
                 high = scene.z_range.high + rng.uniform(0, config.range_jitter) * span;
    crop = scene::make_crop(scene, {.sources = sources,
                                    .target = order[N],
                                    .centre = {x, y, z},
                                    .size = {config.crop, config.crop},
                                    .z_range = {low, high},
                                    .with_truth = true});
    const double known = scene::forget_unseen_truth(crop);
    scene::forget_untold_truth(crop, scene);
    if (known >= kEnough) break;
  }
  const Radiometry radiometry = random_radiometry(config.radiometry, config.grey_share, rng);
  for (nn::PosedImage& v : crop.input.sources) apply(radiometry, v);
  apply(radiometry, *crop.target);
  if (config.radiometry_views > 0)
    for (nn::PosedImage& v : crop.input.sources)
      apply(random_radiometry(config.radiometry_views, 0, rng), v);
  return crop;
}

}  // namespace

scene::Crop training_sample(const TrainConfig& config, const std::vector<scene::Scene>& scenes,
                            std::uint64_t seed, Index sample) {
  const auto draw = [&](Rng& rng) {
    const auto i = static_cast<std::size_t>(rng.below(static_cast<Index>(scenes.size())));
    return std::shared_ptr<const scene::Scene>(std::shared_ptr<void>(), &scenes[i]);  // not owned
  };
  return cut_sample(config, draw, seed, sample);
}

scene::Crop training_sample(const TrainConfig& config, SceneStream& scenes, std::uint64_t seed,
                            Index sample) {
  const auto draw = [&](Rng& rng) {
    return std::make_shared<const scene::Scene>(scenes.draw(sample, rng)->scene());
  };
  return cut_sample(config, draw, seed, sample);
}

bool needs_branch(const TrainConfig& config) {
  if (config.model.mono == nn::MonoBranch::none) return false;
  if (config.init.empty()) return true;
  const std::string prefix = std::string(nn::kModelPrefix) + nn::kMonoPrefix;
  const TensorFile file = load_safetensors(config.init);
  return std::ranges::none_of(file.tensors,
                              [&](const auto& item) { return item.first.starts_with(prefix); });
}

std::vector<std::string> idle_settings(const TrainConfig& config) {
  std::vector<std::string> out;
  if (config.lpips_weight > 0 && config.lpips_weights.empty())
    out.emplace_back("no perceptual loss: lpips_weights names no file");
  const bool mono = config.model.mono != nn::MonoBranch::none;
  if (config.geo_weight > 0 && config.geo_target != GeoTarget::dsm && !mono)
    out.emplace_back("no correlation with relative heights: the network has no monocular branch");
  if (!mono && !config.mono_weights.empty())
    out.emplace_back("mono_weights is not read: the network has no monocular branch");
  return out;
}

void train_on_samples(nn::Model& model, const TrainConfig& config, const SampleSource& sample,
                      const TrainingRun& run, const TrainingCallbacks& callbacks) {
  check_fields(config, "train_on_samples");
  TrainConfig recorded = config;
  recorded.model = model.config();
  CascadeTask task(model, config, sample, run.seed);
  run_training(task, config, to_json(recorded).dump(), run, callbacks);
}

nn::Model train(const TrainConfig& config, const fs::path& data, std::uint64_t seed,
                const fs::path& checkpoint, const TrainingCallbacks& callbacks) {
  check_fields(config, "train");
  if (config.task != Task::cascade)
    throw ConfigError("train: task is " + enum_name(config.task) + ", expected cascade");
  const Index multiple = nn::size_multiple(config.model);
  if (config.crop % multiple != 0)
    throw ConfigError("train: crop is " + std::to_string(config.crop) +
                      ", expected a multiple of " + std::to_string(multiple));
  check_crop_memory(config, config.views + 1);
  const bool resume = !checkpoint.empty();
  const bool branch = !resume && needs_branch(config);
  const fs::path mono = config.mono_weights.empty() ? config.mono_found : config.mono_weights;
  if (branch && mono.empty())
    throw ConfigError(
        "train: no weights of the monocular branch, expected mono_weights: what --task mono made");
  if (!resume && !branch && config.model.mono != nn::MonoBranch::none &&
      !config.mono_weights.empty())
    throw ConfigError("train: mono_weights is " + config.mono_weights.string() + ", but " +
                      config.init.string() +
                      " has a monocular branch already, expected one of them");
  nn::Model model(config.model, seed);
  if (branch) nn::load_mono_branch(model, mono);
  TrainingRun run{.seed = seed, .checkpoint = checkpoint};
  if (data.empty()) {
    if (config.simulate.views <= config.views)
      throw ConfigError("train: simulate.views is " + std::to_string(config.simulate.views) +
                        ", expected more than views, which is " + std::to_string(config.views) +
                        ": one view is the target");
    if (callbacks.reading) callbacks.reading(0);
    run.data = kMadeUp;
    SceneStream scenes(config.simulate, seed, config.scene_uses, config.scene_pool);
    train_on_samples(
        model, config, [&](Index i) { return training_sample(config, scenes, seed, i); }, run,
        callbacks);
    return model;
  }
  const auto scenes = training_scenes(
      data, config.views + 1, callbacks.reading,
      ": the " + std::to_string(config.views) + " of views and one that is rendered");
  run.scenes = scenes.size(), run.data = data_mark(scenes);
  train_on_samples(
      model, config, [&](Index i) { return training_sample(config, scenes, seed, i); }, run,
      callbacks);
  return model;
}

}  // namespace satsurf::train

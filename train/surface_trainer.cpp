// SPDX-License-Identifier: Apache-2.0
#include "satsurf/train/surface_trainer.h"

#include "satsurf/core/fields_json.h"
#include "satsurf/core/symmetry.h"
#include "satsurf/nn/weights_file.h"
#include "satsurf/ops/candidates.h"
#include "satsurf/ops/elementwise.h"
#include "satsurf/reconstruct/reconstruct.h"
#include "satsurf/scene/classes.h"
#include "satsurf/scene/view_geometry.h"
#include "satsurf/train/draw.h"
#include "satsurf/train/sample_batch.h"
#include "satsurf/train/scene_stream.h"
#include "satsurf/train/stream.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <optional>
#include <utility>

namespace satsurf::train {
namespace {

namespace fs = std::filesystem;

/// What is true of every cell of a grid, and whether it counts: known, and no water.
void add_truth(const scene::Scene& scene, const reconstruct::UnrefinedSurface& made,
               SurfaceLesson& lesson) {
  const scene::HeightField& truth = *scene.truth;
  const Index H = made.input.planes.dim(1), W = made.input.planes.dim(2);
  lesson.truth = Tensor({H, W}), lesson.weight = Tensor({H, W});
  for (Index i = 0; i < H; ++i)
    for (Index j = 0; j < W; ++j) {
      const double x = made.x0 + (static_cast<double>(j) + 0.5) * made.step,
                   y = made.y0 - (static_cast<double>(i) + 0.5) * made.step;
      const Index k = scene::cell_at(truth, x, y);
      if (k < 0 || !std::isfinite(truth.z[k])) continue;
      if (!scene.classes.empty() && scene.classes[k] == scene::kWaterClass) continue;
      lesson.truth[i * W + j] = truth.z[k];
      lesson.weight[i * W + j] = 1;
    }
}

/// Mean distance of a surface from the truth, m.
double mean_distance(const float* heights, const SurfaceLesson& lesson,
                     const float* otherwise = nullptr) {
  double sum = 0, n = 0;
  for (Index i = 0; i < lesson.truth.count(); ++i) {
    if (!(lesson.weight[i] > 0)) continue;
    float z = heights[i];
    if (!std::isfinite(z) && otherwise != nullptr) z = otherwise[i];
    if (!std::isfinite(z)) continue;
    sum += std::abs(static_cast<double>(z - lesson.truth[i])), n += 1;
  }
  return n > 0 ? sum / n : std::nan("");
}

/// What teaches heights, and the first network what errors to expect of them.
Var height_loss(const SurfaceTrainConfig& config, const nn::SurfaceOutput<float>& out,
                const Var& height, const SurfaceLesson& lesson, const Tensor& weight) {
  const double unit = lesson.input.interval;
  // The likelihood pulls a height the harder the surer the network is: the last centimetres of level
  // ground would drown what is ten metres off. So it teaches the expected error alone.
  Var total = laplace_loss(Var(height.value()), out.log_scale, lesson.truth, weight, unit);
  if (config.distance_weight > 0)
    total = total +
            affine(laplace_loss(height, Var(Tensor(height.shape())), lesson.truth, weight, unit),
                   static_cast<float>(config.distance_weight), 0.f);
  if (config.choice_weight > 0)
    total = total + affine(candidate_cross_entropy(out.logits, lesson.input.candidates,
                                                   lesson.truth, weight, unit),
                           static_cast<float>(config.choice_weight), 0.f);
  return total;
}

/// Lessons by number.
using LessonStream = Stream<KeptLesson>;

/// The surface network and its objective.
class SurfaceTask : public TrainingTask {
 public:
  SurfaceTask(nn::SurfaceModel& network, const nn::Model& cascade, const SurfaceTrainConfig& config,
              LessonStream& lessons, std::uint64_t seed)
      : network_(network), cascade_(cascade), config_(config), lessons_(lessons), seed_(seed) {
    if (config.batch > 1) batch_.emplace(network, config.batch, seed);
  }

  nn::ParameterSet<float>& parameters() override { return network_.parameters(); }
  std::string prefix() const override { return nn::kSurfacePrefix; }
  void store(TensorFile& file) const override {
    nn::store_model(file, cascade_);
    nn::store_surface(file, network_);
  }
  Index batch() const override { return config_.batch; }
  StepLoss loss(Index sample) const override { return loss(network_, sample); }
  StepLoss descend(Index step) override {
    if (!batch_) return TrainingTask::descend(step);
    return batch_->descend(step, [this](const nn::SurfaceModel& network, Index sample) {
      return loss(network, sample);
    });
  }

 private:
  StepLoss loss(const nn::SurfaceModel& network, Index sample) const {
    Rng rng = Rng(seed_).fork(static_cast<std::uint64_t>(sample));
    // A lesson may have little to say where the images hardly overlap.
    constexpr int kTries = 5;
    constexpr double kEnough = 0.3;
    SurfaceLesson window;
    for (int attempt = 0; attempt < kTries; ++attempt) {
      const auto lesson = lessons_.draw(sample, rng);
      window = lesson->window(config_.crop, rng);
      double known = 0;
      for (const float w : window.weight.values()) known += static_cast<double>(w);
      if (known >= kEnough * static_cast<double>(window.weight.count())) break;
    }
    return surface_loss(config_, network, window);
  }

  nn::SurfaceModel& network_;
  const nn::Model& cascade_;
  const SurfaceTrainConfig& config_;
  LessonStream& lessons_;
  std::uint64_t seed_;
  std::optional<SampleBatch<nn::SurfaceModel>> batch_;
};

}  // namespace

SurfaceLesson surface_lesson(const SurfaceTrainConfig& config,
                             const std::vector<nn::Model>& cascades, scene::Scene scene, Rng rng) {
  std::vector<Index> order = shuffled(std::ssize(scene.views), rng);
  const Index most = std::min(config.views_most, static_cast<Index>(order.size()));
  order.resize(static_cast<std::size_t>(2 + rng.below(most - 1)));
  std::vector<scene::View> views;
  for (const Index i : order) views.push_back(std::move(scene.views[static_cast<std::size_t>(i)]));
  scene.views = std::move(views);
  const double span = scene.z_range.span();
  scene.z_range.low -= rng.uniform(0, config.range_jitter) * span;
  scene.z_range.high += rng.uniform(0, config.range_jitter) * span;
  reconstruct::ReconstructOptions how;
  constexpr double kFinest = 0.5, kCoarsest = 1.5;  // pixels
  const double cell =
      rng.uniform(0, 1) < 0.5 ? 1 : kFinest * std::pow(kCoarsest / kFinest, rng.uniform(0, 1));
  how.resolution = cell * reconstruct::mean_footprint(scene::cameras_at(
                              scene.views, scene.frame, {0, 0, scene.z_range.middle()}));
  const nn::Model& cascade =
      cascades[static_cast<std::size_t>(rng.below(static_cast<Index>(cascades.size())))];
  reconstruct::UnrefinedSurface made = reconstruct::unrefined_surface(cascade, scene, how);
  SurfaceLesson lesson;
  add_truth(scene, made, lesson);
  lesson.input = std::move(made.input);
  return lesson;
}

StepLoss surface_loss(const SurfaceTrainConfig& config, const nn::SurfaceModel& network,
                      const SurfaceLesson& lesson) {
  const double unit = lesson.input.interval;
  const Index P = lesson.truth.count();
  Tensor weight = lesson.weight.clone();
  const Tensor& candidates = lesson.input.candidates;
  const float* views = lesson.input.planes.data() + static_cast<Index>(nn::SurfacePlane::views) * P;
  for (Index i = 0; i < P; ++i)  // no more than what becomes a surface
    if (!nn::has_candidate(candidates, i) || views[i] < nn::kViewsOfTwo) weight[i] = 0;
  const nn::SurfaceOutput<float> out = config.learn == Learn::sigma
                                           ? nn::mean_of_looks(network, lesson.input)
                                           : network(lesson.input);
  const Var height = chosen_height(out.logits, out.residual, candidates, nn::kSurfaceReach * unit);
  const Var total =
      config.learn == Learn::sigma
          ? sigma_loss(height.value(), network.net().log_scale(lesson.input, out, height.value()),
                       lesson.truth, weight, unit, nn::kSigmaOfScale, config.within_two)
          : height_loss(config, out, height, lesson, weight);
  const auto candidate = [&](nn::SurfaceCandidate c) {
    return candidates.data() + static_cast<Index>(c) * P;
  };
  return {total,
          {{"height_mae", mean_distance(height.value().data(), lesson)},
           {"mode_mae", mean_distance(candidate(nn::SurfaceCandidate::mode), lesson,
                                      candidate(nn::SurfaceCandidate::around))}}};
}

KeptLesson::KeptLesson(const SurfaceLesson& lesson)
    : candidates_(lesson.input.candidates),
      planes_(PackedTensor::halves(lesson.input.planes)),
      truth_(lesson.truth),
      weight_(PackedTensor::levels(lesson.weight, 1)),
      interval_(lesson.input.interval) {}

SurfaceLesson KeptLesson::window(Index size, Rng& rng) const {
  const Index H = truth_.shape()[0], W = truth_.shape()[1], S = std::min({size, H, W}),
              top = rng.below(H - S + 1), left = rng.below(W - S + 1),
              symmetry = rng.below(kSymmetries);
  const auto cut = [&](const PackedTensor& map) {
    const bool planes = map.shape().rank() == 3;
    const Index C = planes ? map.shape()[0] : 1;
    auto out = Tensor::uninitialised(planes ? Shape{C, S, S} : Shape{S, S});
    for (Index c = 0; c < C; ++c)
      for (Index i = 0; i < S; ++i)
        map.read((c * H + top + i) * W + left, S, out.data() + (c * S + i) * S);
    return turned(out, symmetry);
  };
  return {{cut(candidates_), cut(planes_), interval_}, cut(truth_), cut(weight_)};
}

std::size_t KeptLesson::bytes() const {
  return candidates_.bytes() + planes_.bytes() + truth_.bytes() + weight_.bytes();
}

nn::SurfaceModel train(const SurfaceTrainConfig& config, const fs::path& data, std::uint64_t seed,
                       const fs::path& checkpoint, const TrainingCallbacks& callbacks) {
  check_fields(config, "train");
  if (config.task != Task::surface)
    throw ConfigError("train: task is " + enum_name(config.task) + ", expected surface");
  if (config.cascades.empty())
    throw ConfigError("train: no cascades, expected weights of at least one");
  if (config.learn == Learn::sigma && config.surface.sigma_hidden == 0)
    throw ConfigError("train: learn is sigma and surface.sigma_hidden is 0, expected 1 or more");
  check_crop_memory(config, 2);
  std::vector<nn::Model> cascades;
  for (const fs::path& file : config.cascades) cascades.push_back(nn::load_model(file));
  nn::SurfaceModel network(config.surface, seed);
  TrainingRun run{.seed = seed, .checkpoint = checkpoint};
  std::vector<scene::Scene> scenes;
  if (!data.empty()) {
    scenes = training_scenes(data, 2, callbacks.reading);
    run.scenes = scenes.size(), run.data = data_mark(scenes);
  } else {
    run.data = kMadeUp;
    scene::check_config(config.simulate);
    if (config.simulate.views < 2)
      throw ConfigError("train: simulate.views is " + std::to_string(config.simulate.views) +
                        ", expected two or more");
    if (callbacks.reading) callbacks.reading(0);
  }
  LessonStream lessons(config.scene_uses, config.scene_pool, [&](Index number) {
    scene::Scene scene = data.empty() ? made_up_scene(config.simulate, seed, number)
                                      : scenes[static_cast<std::size_t>(number) % scenes.size()];
    return KeptLesson(surface_lesson(config, cascades, std::move(scene),
                                     Rng(seed).fork(~static_cast<std::uint64_t>(number))));
  });
  SurfaceTask task(network, cascades[0], config, lessons, seed);
  run_training(task, config, to_json(config).dump(), run, callbacks);
  return network;
}

}  // namespace satsurf::train

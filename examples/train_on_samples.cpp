// SPDX-License-Identifier: Apache-2.0
// Trains the surface network on samples of one's own: here windows of places that are made up in
// memory, but any function that returns a scene::Crop will do. Needs satsurf::satsurf.
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <vector>

#include <satsurf/core/rng.h>
#include <satsurf/nn/weights_file.h>
#include <satsurf/scene/crop.h>
#include <satsurf/scene/simulate/scene.h>
#include <satsurf/train/trainer.h>

using namespace satsurf;

namespace {

/// A place with its true heights and four images of 48 m x 48 m.
scene::Scene made_up(Index number) {
  scene::SimulateConfig config;
  config.pixels = 96;
  config.gsd = 0.5;
  config.views = 4;
  config.kinds = {scene::SceneKind::village};
  config.relief_max = 10;
  const scene::SimulatedScene from = scene::simulate_scene(config, 7, number);
  scene::Scene to;
  to.frame = from.frame;
  to.truth = from.dsm;
  to.z_range = from.frame.z_from_heights({from.h_min, from.h_max});
  for (const scene::SimulatedView& view : from.views) {
    scene::View& v = to.views.emplace_back();
    v.rgb = view.rgb;
    v.valid = Tensor({view.rgb.dim(1), view.rgb.dim(2)}, 1);
    v.rpc = view.rpc;
  }
  return to;
}

/// Three windows around a random point of a random place, a fourth to be rendered, and the truth.
scene::Crop sample_of(const std::vector<scene::Scene>& places, Index step) {
  Rng rng = Rng(1).fork(static_cast<std::uint64_t>(step));
  const scene::Scene& place =
      places[static_cast<std::size_t>(rng.below(static_cast<Index>(places.size())))];
  const scene::HeightField& dsm = *place.truth;
  const double half = 0.5 * dsm.step * static_cast<double>(dsm.z.dim(0));
  return scene::make_crop(
      place, {.sources = {0, 1, 2},
              .target = 3,
              .centre = {dsm.x0 + half + rng.uniform(-8, 8), dsm.y0 - half + rng.uniform(-8, 8),
                         0.5 * (place.z_range.low + place.z_range.high)},
              .size = {32, 32},
              .z_range = place.z_range,
              .with_truth = true});
}

/// Mean error of the heights of the last stage over a few samples, m.
double height_error(const nn::Model& model, const std::vector<scene::Scene>& places) {
  const NoGrad no_grad;
  double sum = 0, count = 0;
  for (Index k = 0; k < 8; ++k) {
    const scene::Crop crop = sample_of(places, k);
    const Tensor height = model.forward(crop.input)[2].height.value();
    for (std::size_t view = 0; view < 3; ++view) {
      const Tensor& truth = crop.source_truth[2][view];
      const float* h = height.data() + static_cast<Index>(view) * truth.count();
      for (Index i = 0; i < truth.count(); ++i)
        if (std::isfinite(truth[i])) sum += std::abs(h[i] - truth[i]), count += 1;
    }
  }
  return sum / count;
}

}  // namespace

int main() {
  const std::vector<scene::Scene> places{made_up(0), made_up(1), made_up(2)}, others{made_up(3)};
  train::TrainConfig config;
  config.steps = 80;
  config.lr = 3e-3;
  nn::Model model(nn::model_preset("tiny"), 1);
  const double before = height_error(model, others);

  const auto sample = [&](Index step) { return sample_of(places, step); };
  std::vector<double> losses;  // means over twenty steps
  const auto report = [&](const train::StepReport& r) {
    if (r.step % 20 == 1) losses.push_back(0);
    losses.back() += r.loss / 20;
    if (r.step % 20 == 0)
      std::printf("step %td of %td: loss %.3f\n", r.step, r.steps, losses.back());
    return true;  // false stops
  };
  const auto folder = std::filesystem::temp_directory_path() / "satsurf-train-on-samples";
  train::train_on_samples(model, config, sample, {.seed = 1}, train::keep_in(folder, report));

  const nn::Model kept = nn::load_model(folder / "weights.safetensors");
  const double after = height_error(model, others), loaded = height_error(kept, others);
  std::printf("height error on another place: %.2f m before, %.2f m after; %.2f m from the file\n",
              before, after, loaded);
  std::filesystem::remove_all(folder);
  return losses.back() < losses.front() && after < before && loaded == after ? 0 : 1;
}

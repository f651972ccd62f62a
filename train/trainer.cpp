// SPDX-License-Identifier: Apache-2.0
#include "satsurf/train/trainer.h"

#include "satsurf/core/atomic_file.h"
#include "satsurf/core/fields_json.h"
#include "satsurf/train/loss.h"
#include "satsurf/train/record.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <fstream>
#include <numeric>
#include <optional>
#include <set>

#include <nlohmann/json.hpp>

namespace satsurf::train {
namespace {

namespace fs = std::filesystem;

std::vector<Scene> load_all(const fs::path& folder, Index views,
                            const std::function<void(double)>& reading) {
  const std::vector<std::string> names = list_scenes(folder);
  std::vector<Scene> scenes;
  for (const std::string& name : names) {
    if (reading) reading(static_cast<double>(scenes.size()) / static_cast<double>(names.size()));
    Scene scene = load_scene(folder, name);
    if (static_cast<Index>(scene.views.size()) <= views)
      throw IoError(folder.string() + ": scene " + name + " has " +
                    std::to_string(scene.views.size()) + " images, expected more than " +
                    std::to_string(views) + " (the sources and one target)");
    if (!scene.truth)
      throw IoError(scene.truth_file.string() + ": no such file, wanted the truth to train with");
    scenes.push_back(std::move(scene));
  }
  return scenes;
}

/// Random gain, offset and gamma, the same for all views of the sample; optionally luminance only.
void vary(Crop& crop, const TrainConfig& config, Rng& rng) {
  const double r = config.radiometry;
  const double gain = rng.uniform(1 - r, 1 + r), offset = rng.uniform(-r / 2, r / 2),
               gamma = std::exp(rng.uniform(-r, r));
  const bool grey = rng.chance(config.grey_share);
  const auto apply = [&](nn::View& view) {
    const Index P = view.valid.count();
    for (Index i = 0; i < P; ++i) {
      if (view.valid[i] <= 0) continue;
      double c[3];
      for (Index k = 0; k < 3; ++k)
        c[k] = std::clamp(gain * std::pow(static_cast<double>(view.rgb[k * P + i]), gamma) + offset,
                          0.0, 1.0);
      if (grey) c[0] = c[1] = c[2] = 0.299 * c[0] + 0.587 * c[1] + 0.114 * c[2];  // Rec. 601 luma
      for (Index k = 0; k < 3; ++k) view.rgb[k * P + i] = static_cast<float>(c[k]);
    }
  };
  for (nn::View& v : crop.input.sources) apply(v);
  if (crop.target) apply(*crop.target);
}

/// `lr: saved 0.001 vs given 0.1, ...`: the fields in which two runs differ; empty if there are
/// none.
std::string differences(nlohmann::json saved, const std::string& saved_seed, nlohmann::json given,
                        std::uint64_t seed) {
  constexpr int kMost = 6;  // told by name; another preset changes them all
  saved = saved.flatten(), given = given.flatten();
  saved["/seed"] = nlohmann::json::parse(saved_seed, nullptr, false), given["/seed"] = seed;
  std::set<std::string> names;
  for (const auto* fields : {&saved, &given})
    for (const auto& item : fields->items()) names.insert(item.key());
  std::string text;
  int count = 0;
  for (const std::string& name : names) {
    const nlohmann::json was = saved.value(name, nlohmann::json()),
                         is = given.value(name, nlohmann::json());
    if (was == is || ++count > kMost) continue;
    std::string field = name.substr(1);
    std::ranges::replace(field, '/', '.');
    text += (text.empty() ? "" : ", ") + field + ": saved " + was.dump() + " vs given " + is.dump();
  }
  if (count > kMost) text += " and " + std::to_string(count - kMost) + " more";
  return text;
}

/// Appends one line per step; on resuming, drops the lines of steps that will be run again.
class Journal {
 public:
  Journal(const fs::path& path, Index keep_steps) {
    std::string kept;
    if (keep_steps > 0) {
      std::ifstream in(path);
      std::string line;
      for (Index n = 0; n < keep_steps && std::getline(in, line); ++n) kept += line + '\n';
    }
    atomic_write(path, kept);
    out_.open(path, std::ios::app);
    if (!out_) throw IoError(path.string() + ": cannot be written");
  }
  void add(const StepReport& r) {
    nlohmann::ordered_json line{{"step", r.step},
                                {"loss", r.loss},
                                {"height_mae", r.height_mae},
                                {"colour_psnr", r.colour_psnr},
                                {"lr", r.lr},
                                {"grad_norm", r.grad_norm},
                                {"seconds", r.seconds}};
    out_ << line.dump() << '\n' << std::flush;
  }

 private:
  std::ofstream out_;
};

}  // namespace

Crop training_sample(const TrainConfig& config, const std::vector<Scene>& scenes,
                     std::uint64_t seed, Index step) {
  Rng rng = Rng(seed).fork(static_cast<std::uint64_t>(step));
  // A window may lie where the truth is unknown or outside an image; a few tries always find a good
  // one.
  constexpr int kTries = 20;
  constexpr double kEnough = 0.6;  // share of source pixels with a known height
  Crop crop;
  for (int attempt = 0; attempt < kTries; ++attempt) {
    const Scene& scene =
        scenes[static_cast<std::size_t>(rng.below(static_cast<Index>(scenes.size())))];
    std::vector<Index> order(scene.views.size());
    std::iota(order.begin(), order.end(), Index{0});
    for (std::size_t i = order.size(); i-- > 1;)
      std::swap(order[i], order[static_cast<std::size_t>(rng.below(static_cast<Index>(i) + 1))]);
    const auto N = static_cast<std::size_t>(config.views);
    const std::vector<Index> sources(order.begin(), order.begin() + static_cast<std::ptrdiff_t>(N));

    // Around a random pixel of the first source, far enough inside for the window where the image
    // is large enough.
    const HeightField& truth = *scene.truth;
    const SceneView& first = scene.views[static_cast<std::size_t>(sources[0])];
    const auto inner = [&](Index extent) {
      const double half = 0.5 * static_cast<double>(std::min(config.crop, extent));
      return rng.uniform(half - 0.5, std::max(half, static_cast<double>(extent) - half) - 0.5);
    };
    const double px = inner(first.rgb.dim(2)), py = inner(first.rgb.dim(1));
    double x = 0, y = 0, z = 0.5 * (scene.z_low + scene.z_high);
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
    const double span = scene.z_high - scene.z_low;
    const double low = scene.z_low - rng.uniform(0, config.range_jitter) * span,
                 high = scene.z_high + rng.uniform(0, config.range_jitter) * span;
    crop = make_crop(scene, sources, order[N], x, y, z, config.crop, low, high, true);
    Index known = 0, all = 0;
    for (std::size_t i = 0; i < N; ++i)
      for (Index p = 0; p < config.crop * config.crop; ++p, ++all) {
        const bool seen = crop.input.sources[i].valid[p] > 0;
        if (!seen)
          for (std::size_t s = 0; s < 3; ++s) {  // no image, no lesson
            const Index stride = Index{4} >> s, w = config.crop / stride;
            crop.source_truth[s][i][(p / config.crop / stride) * w + p % config.crop / stride] =
                std::nanf("");
          }
        known += seen && std::isfinite(crop.source_truth[2][i][p]) ? 1 : 0;
      }
    if (static_cast<double>(known) >= kEnough * static_cast<double>(all)) break;
  }
  vary(crop, config, rng);
  return crop;
}

void train(const TrainConfig& config, const fs::path& data, OutputFolder out, std::uint64_t seed,
           bool resume, const StepCallback& callback, const std::function<void(double)>& reading) {
  check_fields(config, "train");
  const Index multiple = nn::size_multiple(config.model);
  if (config.crop % multiple != 0)
    throw ConfigError("train: crop is " + std::to_string(config.crop) +
                      ", expected a multiple of " + std::to_string(multiple));
  const std::vector<Scene> scenes = load_all(data, config.views, reading);

  const std::string record = to_json(config).dump();
  nn::Model model(config.model, seed);
  nn::AdamW optimiser(model.parameters(), {.weight_decay = config.weight_decay});
  Index step = 0;
  if (!config.init.empty() && !resume)
    model.parameters().load(load_safetensors(config.init), "model.", config.init);
  if (resume) {
    const fs::path checkpoint = out / "checkpoint.safetensors";
    const TensorFile file = load_safetensors(checkpoint);
    const auto saved = file.metadata.find("train"), saved_seed = file.metadata.find("seed");
    if (saved == file.metadata.end() || saved_seed == file.metadata.end())
      throw IoError(checkpoint.string() +
                    ": no training state, expected a checkpoint that train wrote");
    const nlohmann::json before = parse_json(saved->second, checkpoint.string());
    if (!before.is_object())
      throw IoError(checkpoint.string() + ": its configuration is " + before.dump() +
                    ", expected a JSON object");
    const std::string others = differences(before, saved_seed->second, to_json(config), seed);
    if (!others.empty())
      throw ConfigError(checkpoint.string() +
                        ": made with another configuration, expected the same to resume; " +
                        others);
    model.parameters().load(file, "model.", checkpoint.string());
    optimiser.load(file, checkpoint.string());
    step = optimiser.steps();
  }
  std::optional<nn::Lpips> lpips;
  if (!config.lpips_weights.empty()) lpips = nn::Lpips::load(config.lpips_weights);
  Journal journal(out / "train.jsonl", step);

  const auto save = [&] {
    const std::map<std::string, std::string> origin{{"train", record},
                                                    {"seed", std::to_string(seed)},
                                                    {"step", std::to_string(step)},
                                                    {"scenes", std::to_string(scenes.size())},
                                                    {"version", program_version()},
                                                    {"git", program_git_hash()}};
    TensorFile file;
    file.metadata = origin;
    store_model(file, model);
    optimiser.store(file);
    save_safetensors(out / "checkpoint.safetensors", file);
    save_model(out / "weights.safetensors", model, origin);
  };

  for (bool go_on = true; go_on && step < config.steps;) {
    const auto start = std::chrono::steady_clock::now();
    const Crop crop = training_sample(config, scenes, seed, step);
    const LossContext context{step, seed, lpips ? &*lpips : nullptr};
    model.parameters().clear_grads();
    StepReport report{.step = step + 1,
                      .steps = config.steps,
                      .lr = nn::one_cycle_lr(config.lr, config.warmup, step, config.steps)};
    {
      const LossReport loss =
          training_loss(config, model.config(), model.forward(crop.input), crop, context);
      report.loss = static_cast<double>(loss.total.value().item());
      report.height_mae = loss.height_mae;
      report.colour_psnr = loss.colour_psnr;
      if (std::isfinite(report.loss)) loss.total.backward();
    }
    if (!std::isfinite(report.loss)) {  // once more under guard, to name the op that broke
      const NanGuard guard;
      training_loss(config, model.config(), model.forward(crop.input), crop, context);
      throw Error("train: the loss of step " + std::to_string(step + 1) + " is not finite");
    }
    report.grad_norm = nn::clip_gradient_norm(model.parameters(), config.clip);
    if (!std::isfinite(report.grad_norm))
      throw Error("train: the gradient of step " + std::to_string(step + 1) + " is not finite");
    optimiser.step(report.lr);
    ++step;
    report.seconds =
        std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    journal.add(report);
    if (callback) go_on = callback(report);
    if (!go_on || step == config.steps || step % config.checkpoint_every == 0 ||
        !out.in_its_place())
      save();
    out.commit();
  }
}

}  // namespace satsurf::train

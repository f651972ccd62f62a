// SPDX-License-Identifier: Apache-2.0
#include "satsurf/train/training.h"

#include "satsurf/core/atomic_file.h"
#include "satsurf/nn/adamw.h"
#include "satsurf/train/log.h"
#include "satsurf/train/record.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <fstream>
#include <map>
#include <set>

namespace satsurf::train {
namespace {

namespace fs = std::filesystem;

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
    nlohmann::ordered_json line{{"step", r.step}, {"loss", r.loss}};
    for (const auto& [name, value] : r.terms) line[name] = value;
    line["lr"] = r.lr;
    line["grad_norm"] = r.grad_norm;
    line["seconds"] = r.seconds;
    out_ << line.dump() << '\n' << std::flush;
  }

 private:
  std::ofstream out_;
};

/// The configuration for files that are handed on: other files by name, not where they lie here.
nlohmann::json without_folders(nlohmann::json config) {
  for (const char* field : {"init", "mono_weights", "lpips_weights"})
    if (const auto it = config.find(field); it != config.end())
      *it = fs::path(it->get<std::string>()).filename().string();
  return config;
}

/// Takes what a weights file has of the network.
void start_from(const std::string& init, TrainingTask& task) {
  const std::vector<std::string> missing =
      task.parameters().load_present(load_safetensors(init), task.prefix(), init);
  if (missing.empty()) return;
  log_line(LogLevel::info, init + ": has all but " + std::to_string(missing.size()) + " of the " +
                               std::to_string(task.parameters().entries().size()) +
                               " parameters; " + missing.front() + " to " + missing.back() +
                               " start as without it");
}

/// Takes network and optimiser from a checkpoint of the same run.
void resume_from(const fs::path& checkpoint, TrainingTask& task, nn::AdamW& optimiser,
                 const nlohmann::json& config, std::uint64_t seed) {
  const TensorFile file = load_safetensors(checkpoint);
  const auto saved = file.metadata.find("train"), saved_seed = file.metadata.find("seed");
  if (saved == file.metadata.end() || saved_seed == file.metadata.end())
    throw IoError(checkpoint.string() +
                  ": no training state, expected a checkpoint that train wrote");
  const nlohmann::json before = parse_json(saved->second, checkpoint.string());
  if (!before.is_object())
    throw IoError(checkpoint.string() + ": its configuration is " + before.dump() +
                  ", expected a JSON object");
  const std::string others = differences(before, saved_seed->second, config, seed);
  if (!others.empty())
    throw ConfigError(checkpoint.string() +
                      ": made with another configuration, expected the same to resume; " + others);
  task.parameters().load(file, task.prefix(), checkpoint.string());
  optimiser.load(file, checkpoint.string());
}

}  // namespace

double StepReport::term(const std::string& name) const {
  for (const auto& [key, value] : terms)
    if (key == name) return value;
  return std::nan("");
}

std::vector<Scene> training_scenes(const fs::path& folder, Index least,
                                   const std::function<void(double)>& reading) {
  const std::vector<std::string> names = list_scenes(folder);
  std::vector<Scene> scenes;
  for (const std::string& name : names) {
    if (reading) reading(static_cast<double>(scenes.size()) / static_cast<double>(names.size()));
    Scene scene = load_scene(folder, name);
    if (static_cast<Index>(scene.views.size()) < least)
      throw IoError(folder.string() + ": scene " + name + " has " +
                    std::to_string(scene.views.size()) + " images, expected at least " +
                    std::to_string(least));
    if (!scene.truth)
      throw IoError(scene.truth_file.string() + ": no such file, wanted the truth to train with");
    scenes.push_back(std::move(scene));
  }
  return scenes;
}

void run_training(TrainingTask& task, const TrainingSettings& settings,
                  const nlohmann::json& config, std::size_t scenes, OutputFolder out,
                  std::uint64_t seed, bool resume, const StepCallback& callback) {
  nn::AdamW optimiser(task.parameters(), {.weight_decay = settings.weight_decay});
  if (resume)
    resume_from(out / "checkpoint.safetensors", task, optimiser, config, seed);
  else if (!settings.init.empty())
    start_from(settings.init, task);
  Index step = optimiser.steps();
  Journal journal(out / "train.jsonl", step);

  const auto save = [&] {
    TensorFile file;
    file.metadata = {{"train", config.dump()},       {"seed", std::to_string(seed)},
                     {"step", std::to_string(step)}, {"scenes", std::to_string(scenes)},
                     {"version", program_version()}, {"git", program_git_hash()}};
    task.store(file);
    TensorFile all = file;
    optimiser.store(all);
    save_safetensors(out / "checkpoint.safetensors", all);
    file.metadata["train"] = without_folders(config).dump();
    save_safetensors(out / "weights.safetensors", file);
  };

  for (bool go_on = true; go_on && step < settings.steps;) {
    const auto start = std::chrono::steady_clock::now();
    task.parameters().clear_grads();
    StepReport report{.step = step + 1,
                      .steps = settings.steps,
                      .lr = nn::one_cycle_lr(settings.lr, settings.warmup, step, settings.steps)};
    {
      StepLoss loss = task.loss(step);
      report.loss = static_cast<double>(loss.total.value().item());
      report.terms = std::move(loss.terms);
      if (std::isfinite(report.loss)) loss.total.backward();
    }
    report.grad_norm = std::isfinite(report.loss)
                           ? nn::clip_gradient_norm(task.parameters(), settings.clip)
                           : std::nan("");
    if (!std::isfinite(report.grad_norm)) {  // once more under guard, to name the op that broke
      task.parameters().clear_grads();
      const NanGuard guard;
      task.loss(step).total.backward();
      throw Error(std::string("train: the ") + (std::isfinite(report.loss) ? "gradient" : "loss") +
                  " of step " + std::to_string(step + 1) + " is not finite");
    }
    optimiser.step(report.lr);
    ++step;
    report.seconds =
        std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    journal.add(report);
    if (callback) go_on = callback(report);
    if (!go_on || step == settings.steps || step % settings.checkpoint_every == 0 ||
        !out.in_its_place())
      save();
    out.commit();
  }
}

}  // namespace satsurf::train

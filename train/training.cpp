// SPDX-License-Identifier: Apache-2.0
#include "satsurf/train/training.h"

#include "satsurf/core/atomic_file.h"
#include "satsurf/core/fields_json.h"
#include "satsurf/core/files.h"
#include "satsurf/core/hash.h"
#include "satsurf/core/memory.h"
#include "satsurf/core/version.h"
#include "satsurf/nn/adamw.h"
#include "satsurf/nn/running_mean.h"

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <chrono>
#include <cmath>
#include <fstream>
#include <memory>
#include <set>
#include <sstream>
#include <string_view>
#include <system_error>

namespace satsurf::train {
namespace {

namespace fs = std::filesystem;

/// `lr: saved 0.001 vs given 0.1, ...`: the fields in which two runs differ; empty if there are
/// none.
std::string differences(nlohmann::json saved, const std::string& saved_seed, nlohmann::json given,
                        std::uint64_t seed) {
  constexpr int kMost = 6;  // told by name; another preset changes them all
  saved = saved.flatten(), given = given.flatten();
  std::uint64_t number = 0;
  const char* last = saved_seed.data() + saved_seed.size();
  const auto [end, error] = std::from_chars(saved_seed.data(), last, number);
  if (error == std::errc() && end == last)
    saved["/seed"] = number;
  else
    saved["/seed"] = saved_seed;  // of a damaged file
  given["/seed"] = seed;
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

/// The configuration for files that are handed on: other files by name, not where they lie here.
nlohmann::json without_folders(nlohmann::json config) {
  const auto strip = [](nlohmann::json& file) {
    file = fs::path(file.get<std::string>()).filename().string();
  };
  for (const char* field : {"init", "mono_weights", "lpips_weights", "cascades"}) {
    const auto it = config.find(field);
    if (it == config.end()) continue;
    if (it->is_array())
      std::ranges::for_each(*it, strip);
    else
      strip(*it);
  }
  return config;
}

/// Takes what a weights file has of the network.
void start_from(const fs::path& init, TrainingTask& task, const TrainingCallbacks& callbacks) {
  const std::vector<std::string> missing =
      task.parameters().load_present(load_safetensors(init), task.prefix(), init.string());
  if (missing.empty() || !callbacks.note) return;
  callbacks.note(init.string() + ": has all but " + std::to_string(missing.size()) + " of the " +
                 std::to_string(task.parameters().entries().size()) + " parameters; " +
                 missing.front() + " to " + missing.back() + " start as without it");
}

/// Takes network, optimiser and averaged weights from a checkpoint of the same run.
/// average  none where nothing is averaged
void resume_from(const TrainingRun& run, TrainingTask& task, nn::AdamW& optimiser,
                 nn::RunningMean* average, const nlohmann::json& config) {
  const fs::path& checkpoint = run.checkpoint;
  const TensorFile file = load_safetensors(checkpoint);
  const auto saved = file.metadata.find("train"), saved_seed = file.metadata.find("seed");
  if (saved == file.metadata.end() || saved_seed == file.metadata.end())
    throw IoError(checkpoint.string() +
                  ": no training state, expected a checkpoint that train wrote");
  const nlohmann::json before = parse_json(saved->second, checkpoint.string());
  if (!before.is_object())
    throw IoError(checkpoint.string() + ": its configuration is " + before.dump() +
                  ", expected a JSON object");
  const std::string others = differences(before, saved_seed->second, config, run.seed);
  if (!others.empty())
    throw ConfigError(checkpoint.string() +
                      ": made with another configuration, expected the same to resume; " + others);
  const auto data = file.metadata.find("data");  // older ones do not tell
  if (data != file.metadata.end() && !run.data.empty() && data->second != run.data)
    throw ConfigError(checkpoint.string() + ": trained on " + data->second + ", and not on " +
                      run.data + ", expected the same --data to resume");
  task.parameters().load(file, task.prefix(), checkpoint.string());
  optimiser.load(file, checkpoint.string());
  if (average != nullptr) average->load(file, checkpoint.string());
  const auto step = file.metadata.find("step");
  if (step == file.metadata.end() || step->second != std::to_string(optimiser.steps()))
    throw IoError(checkpoint.string() + ": the network is of step " +
                  (step == file.metadata.end() ? "nothing" : step->second) +
                  ", expected that of the optimiser, " + std::to_string(optimiser.steps()));
}

/// Whether a line of `train.jsonl` is of a step before `step`. What a kill or a full disk has left of
/// a line is of none.
bool is_before(const std::string& line, Index step) {
  try {
    const nlohmann::json report = parse_json(line, "train.jsonl");
    if (!report.is_object()) return false;
    const auto of = report.find("step");
    return of != report.end() && of->is_number() && of->get<double>() < static_cast<double>(step);
  } catch (const IoError&) {
    return false;
  }
}

/// The lines of a `train.jsonl` that are of steps before `step`.
/// throws  IoError
std::string lines_before(const fs::path& file, Index step) {
  std::ifstream in(file);
  std::string kept;
  for (std::string line; std::getline(in, line);)
    if (is_before(line, step)) kept += line + '\n';
  if (!in.eof())
    throw IoError(file.string() + ": cannot be read (" + std::generic_category().message(errno) +
                  "), expected the steps of the run so far");
  return kept;
}

[[noreturn]] void cannot_write(const fs::path& file) {
  throw IoError(file.string() + ": cannot be written (" + std::generic_category().message(errno) +
                "), expected a place that can be written");
}

double learning_rate(const TrainingSettings& settings, Index step) {
  if (settings.schedule == Schedule::constant &&
      static_cast<double>(step) >= settings.warmup * static_cast<double>(settings.steps))
    return settings.lr;
  return nn::one_cycle_lr(settings.lr, settings.warmup, step, settings.steps);
}

}  // namespace

void check_crop_memory(const TrainingSettings& settings, Index views) {
  // Of a pixel: colours, mask and heights, and two dozen features of the first layer with their
  // gradients.
  constexpr double kBytes = 200;
  const auto side = static_cast<double>(settings.crop);
  check_memory("train: windows of " + std::to_string(settings.crop) + " px of " +
                   std::to_string(views) + (views == 1 ? " image need" : " images need"),
               kBytes * static_cast<double>(views) * side * side, "give a smaller crop");
}

StepLoss TrainingTask::descend(Index step) {
  StepLoss loss = this->loss(step);
  if (std::isfinite(loss.total.value().item())) loss.total.backward();
  return {BasicVar<float>(loss.total.value()), std::move(loss.terms)};
}

double StepReport::term(const std::string& name) const {
  for (const auto& [key, value] : terms)
    if (key == name) return value;
  return std::nan("");
}

std::vector<scene::Scene> training_scenes(const fs::path& folder, Index least,
                                          const std::function<void(double)>& reading,
                                          const std::string& what) {
  const std::vector<std::string> names = scene::list_scenes(folder);
  std::vector<scene::Scene> scenes;
  for (const std::string& name : names) {
    if (reading) reading(static_cast<double>(scenes.size()) / static_cast<double>(names.size()));
    scene::Scene scene = scene::load_scene(folder, name);
    if (static_cast<Index>(scene.views.size()) < least)
      throw IoError(folder.string() + ": scene " + name + " has " +
                    std::to_string(scene.views.size()) + " images, expected at least " +
                    std::to_string(least) + what);
    if (!scene.truth)
      throw IoError(scene.truth_file.string() + ": no such file, expected the truth to train with");
    scenes.push_back(std::move(scene));
  }
  return scenes;
}

std::string data_mark(const std::vector<scene::Scene>& scenes) {
  std::string all;
  for (const scene::Scene& scene : scenes) {
    all += scene.name;
    for (const scene::View& view : scene.views) all += '\n' + view.name + view.rgb.shape().str();
    const auto heights = scene.truth->z.values();
    const std::string_view bytes(reinterpret_cast<const char*>(heights.data()),
                                 heights.size_bytes());
    all += '\n' + std::to_string(fnv1a(bytes)) + '\n';
  }
  std::ostringstream mark;
  mark << scenes.size() << " scenes of hash " << std::hex << fnv1a(all);
  return mark.str();
}

void TrainingFolder::add(const StepReport& r) {
  const fs::path file = folder_ / "train.jsonl";
  if (!lines_.is_open()) {
    atomic_write(file, r.step > 1 && is_file(file) ? lines_before(file, r.step) : "");
    lines_.open(file, std::ios::app);
    if (!lines_) cannot_write(file);
  }
  nlohmann::ordered_json line{{"step", r.step}, {"loss", r.loss}};
  for (const auto& [name, value] : r.terms) line[name] = value;
  line["lr"] = r.lr;
  line["grad_norm"] = r.grad_norm;
  line["seconds"] = r.seconds;
  lines_ << line.dump() << '\n' << std::flush;
  if (!lines_) cannot_write(file);
}

void TrainingFolder::save(const TensorFile& checkpoint, const TensorFile& weights) const {
  save_safetensors(folder_ / "checkpoint.safetensors", checkpoint);
  save_safetensors(folder_ / "weights.safetensors", weights);
}

TrainingCallbacks keep_in(const fs::path& folder, std::function<bool(const StepReport&)> step) {
  fs::create_directories(folder);
  const auto files = std::make_shared<TrainingFolder>(folder);
  TrainingCallbacks callbacks;
  callbacks.step = [files, step = std::move(step)](const StepReport& report) {
    files->add(report);
    return !step || step(report);
  };
  callbacks.save = [files](const TensorFile& checkpoint, const TensorFile& weights) {
    files->save(checkpoint, weights);
  };
  return callbacks;
}

void run_training(TrainingTask& task, const TrainingSettings& settings,
                  const std::string& config_text, const TrainingRun& run,
                  const TrainingCallbacks& callbacks) {
  const nlohmann::json config = parse_json(config_text, "train");
  nn::AdamW optimiser(task.parameters(), {.weight_decay = settings.weight_decay});
  const bool resume = !run.checkpoint.empty();
  if (!resume && !settings.init.empty()) start_from(settings.init, task, callbacks);
  nn::RunningMean average(task.parameters(), settings.average);
  if (resume) resume_from(run, task, optimiser, settings.average > 0 ? &average : nullptr, config);
  Index step = optimiser.steps();

  const auto save = [&] {
    if (!callbacks.save) return;
    TensorFile weights;
    weights.metadata = {{"train", config.dump()},       {"seed", std::to_string(run.seed)},
                        {"step", std::to_string(step)}, {"scenes", std::to_string(run.scenes)},
                        {"version", program_version()}, {"git", program_git_hash()}};
    task.store(weights);
    TensorFile checkpoint = weights;
    if (!run.data.empty()) checkpoint.metadata["data"] = run.data;
    optimiser.store(checkpoint);
    if (settings.average > 0) {
      average.store(checkpoint);
      average.swap();
      task.store(weights);
      average.swap();
    }
    weights.metadata["train"] = without_folders(config).dump();
    weights.half = settings.half;
    callbacks.save(checkpoint, weights);
  };

  // A run that was killed between its two files left weights of an earlier step.
  if (resume) save();
  for (bool go_on = true; go_on && step < settings.steps;) {
    const auto start = std::chrono::steady_clock::now();
    task.parameters().clear_grads();
    StepReport report{
        .step = step + 1, .steps = settings.steps, .lr = learning_rate(settings, step)};
    {
      StepLoss loss = task.descend(step);
      report.loss = static_cast<double>(loss.total.value().item());
      report.terms = std::move(loss.terms);
    }
    report.grad_norm = std::isfinite(report.loss)
                           ? nn::clip_gradient_norm(task.parameters(), settings.clip)
                           : std::nan("");
    if (!std::isfinite(report.grad_norm)) {  // once more under guard, to name the op that broke
      task.parameters().clear_grads();
      const NanGuard guard;
      for (Index b = 0; b < task.batch(); ++b) task.loss(step * task.batch() + b).total.backward();
      throw Error(std::string("train: the ") + (std::isfinite(report.loss) ? "gradient" : "loss") +
                  " of step " + std::to_string(step + 1) + " is not finite");
    }
    optimiser.step(report.lr);
    average.add();
    ++step;
    report.seconds =
        std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    if (callbacks.step) go_on = callbacks.step(report);
    if (!go_on || step == settings.steps || step % settings.checkpoint_every == 0 || step == 1)
      save();
  }
}

}  // namespace satsurf::train

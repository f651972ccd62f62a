// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/commands.h"
#include "satsurf/app/log.h"
#include "satsurf/app/output_folder.h"
#include "satsurf/app/progress.h"
#include "satsurf/app/record.h"
#include "satsurf/app/training_output.h"
#include "satsurf/core/fields_json.h"
#include "satsurf/nn/shipped_weights.h"

#include <cmath>
#include <cstdio>
#include <deque>
#include <filesystem>
#include <numeric>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include <nlohmann/json.hpp>

namespace satsurf::app {
namespace {

namespace fs = std::filesystem;

/// One term of the objective, on average over the last hundred steps that know it.
class RecentTerm {
 public:
  /// format  of the average, for people
  RecentTerm(std::string term, std::string format)
      : term_(std::move(term)), format_(std::move(format)) {}

  void add(const train::StepReport& report) {
    const double value = report.term(term_);
    if (!std::isfinite(value)) return;
    values_.push_back(value);
    constexpr std::size_t kRecent = 100;
    if (values_.size() > kRecent) values_.pop_front();
  }
  std::string name() const { return term_ + "_running"; }
  Index count() const { return static_cast<Index>(values_.size()); }
  /// NaN without any.
  double mean() const {
    if (values_.empty()) return std::nan("");
    return std::accumulate(values_.begin(), values_.end(), 0.0) /
           static_cast<double>(values_.size());
  }
  std::string text() const {
    char text[64];
    std::snprintf(text, sizeof text, format_.c_str(), mean());
    return text;
  }

 private:
  std::string term_, format_;
  std::deque<double> values_;
};

/// Finds the branch that comes with the program, where a new run needs one and names none. Returns
/// the files of weights that the run will read.
std::vector<fs::path> prepare(train::TrainConfig& config, bool resume) {
  if (!resume && config.mono_weights.empty() && train::needs_branch(config))
    config.mono_found = nn::shipped_weights(nn::ShippedNetwork::mono, "give --mono_weights FILE");
  std::vector<fs::path> files;
  if (config.model.mono != nn::MonoBranch::none) files = {config.mono_weights, config.mono_found};
  files.insert(files.end(), {config.init, config.lpips_weights});
  std::erase(files, fs::path());
  return files;
}
std::vector<fs::path> prepare(train::MonoTrainConfig& config, bool) {
  return config.init.empty() ? std::vector<fs::path>() : std::vector<fs::path>{config.init};
}

}  // namespace

void run_train(const TrainOptions& options) {
  auto config = options.config;
  const auto settings =
      std::visit([](const auto& c) -> train::TrainingSettings { return c; }, config);
  const std::vector<fs::path> weights =
      std::visit([&](auto& c) { return prepare(c, options.resume); }, config);
  std::vector<fs::path> inputs{options.data, options.config_file};
  inputs.insert(inputs.end(), weights.begin(), weights.end());
  TrainingOutput folder(options.resume
                            ? OutputFolder::in_place(options.out)
                            : OutputFolder::staged(options.out, options.overwrite, inputs));
  Progress progress;
  train::StepReport last;
  scene::list_scenes(options.data);  // a wrong folder is told before its files are read
  RunRecord record("train", std::visit([](const auto& c) { return to_json(c); }, config),
                   options.seed);
  record.add_input(options.data);
  for (const fs::path& file : weights) record.add_input(file);
  if (!options.resume)
    record.save(folder / "run.json");  // marks the folder as a run from the start
  RecentTerm watched = settings.task == "mono" ? RecentTerm("correlation", "correlation %.3f")
                                               : RecentTerm("height_mae", "height error %.2f m");
  train::TrainingCallbacks callbacks;
  callbacks.step = [&](const train::StepReport& r) {
    if (interrupted() && r.step == 1) throw Interrupted{};  // before anything is worth keeping
    folder.add(r);
    watched.add(r);
    last = r;
    char text[160];
    std::snprintf(text, sizeof text, "step %td/%td  loss %.4f  %s  %.2f s/step", r.step, r.steps,
                  r.loss, watched.text().c_str(), r.seconds);
    progress.update("train", static_cast<double>(r.step) / static_cast<double>(r.steps), text);
    return !interrupted();
  };
  callbacks.save = [&](const TensorFile& checkpoint, const TensorFile& network) {
    folder.save(checkpoint, network);
  };
  callbacks.reading = [&](double read) {  // what can be wrong with the settings has been told
    if (interrupted()) throw Interrupted{};
    if (const auto* c = std::get_if<train::TrainConfig>(&config); c != nullptr && read == 0)
      for (const std::string& text : train::idle_settings(*c)) log_line(LogLevel::info, text);
    progress.update("read", read);
  };
  callbacks.note = [](const std::string& text) { log_line(LogLevel::info, text); };
  std::visit(
      [&](const auto& c) {
        train::train(c, options.data, options.seed,
                     options.resume ? folder.checkpoint() : fs::path(), callbacks);
      },
      config);
  record.results() = {
      {"step", last.step}, {"steps", settings.steps}, {watched.name(), watched.mean()}};
  record.save(options.out / "run.json");
  if (interrupted() && last.step < settings.steps) throw Interrupted{};
  std::printf("%td steps done; weights in %s\n", settings.steps,
              (options.out / "weights.safetensors").c_str());
  if (watched.count() > 0)
    std::printf("%s, mean of the last %td steps\n", watched.text().c_str(), watched.count());
}

}  // namespace satsurf::app

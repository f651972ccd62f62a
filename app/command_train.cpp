// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/interrupt.h"
#include "satsurf/app/log.h"
#include "satsurf/app/output_folder.h"
#include "satsurf/app/program.h"
#include "satsurf/app/progress.h"
#include "satsurf/app/record.h"
#include "satsurf/app/training_output.h"
#include "satsurf/core/fields_json.h"
#include "satsurf/nn/config.h"
#include "satsurf/nn/shipped_weights.h"
#include "satsurf/scene/dataset.h"
#include "satsurf/train/mono_trainer.h"
#include "satsurf/train/surface_trainer.h"
#include "satsurf/train/trainer.h"

#include <cmath>
#include <cstdio>
#include <deque>
#include <filesystem>
#include <memory>
#include <numeric>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

namespace satsurf::app {
namespace {

namespace fs = std::filesystem;

struct TrainOptions {
  std::variant<train::TrainConfig, train::MonoTrainConfig, train::SurfaceTrainConfig> config;
  fs::path data, out, config_file;
  std::uint64_t seed = 0;
  bool overwrite = false, resume = false;

  /// Of the options those that are no configuration.
  template <class Self, class V>
  static void fields(Self& s, V&& v) {
    v("data", s.data,
      Field{
          .help =
              "data set: what simulate writes, DFC2019 Track 3, EOGS, WHU-TLC or Sat-NeRF; without "
              "one scenes are made up while the training runs (not for --task mono)",
          .placeholder = "DIR"});
    v("out", s.out,
      Field{
          .help = "folder for checkpoint, weights and train.jsonl (required unless --print-config)",
          .placeholder = "DIR"});
    v("seed", s.seed, Field{.help = "of the initial weights and the samples"});
    v("resume", s.resume,
      Field{.help = "go on from the checkpoint in --out, with the same configuration; --steps "
                    "included, for the learning rate is planned over all of them",
            .flag = "--resume"});
    v("overwrite", s.overwrite,
      Field{.help = "replace what an earlier run left in that folder", .flag = "--overwrite"});
  }
};

/// One term of the objective, on average over the last hundred steps that know it.
class RecentTerm {
 public:
  /// before, decimals, after  how the average is shown to people
  RecentTerm(std::string term, std::string before, int decimals, std::string after)
      : term_(std::move(term)),
        before_(std::move(before)),
        after_(std::move(after)),
        decimals_(decimals) {}

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
    return fmt::format("{} {:.{}f}{}", before_, mean(), decimals_, after_);
  }

 private:
  std::string term_, before_, after_;
  int decimals_;
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
std::vector<fs::path> prepare(train::SurfaceTrainConfig& config, bool) {
  if (config.cascades.empty())
    config.cascades = {nn::shipped_weights(nn::ShippedNetwork::cascade, "give --cascades FILE")};
  std::vector<fs::path> files = config.cascades;
  if (!config.init.empty()) files.push_back(config.init);
  return files;
}

/// The folder to train into; one that holds a run is refused with the flag that goes on with it.
OutputFolder output_of(const TrainOptions& options, const std::vector<fs::path>& inputs) {
  if (options.resume) return OutputFolder::in_place(options.out);
  try {
    return OutputFolder::staged(options.out, options.overwrite, inputs);
  } catch (const IoError& e) {
    const std::string text = e.what();
    std::error_code code;
    if (!text.ends_with("use --overwrite") ||
        !fs::exists(options.out / "checkpoint.safetensors", code))
      throw;
    throw IoError(text + ", or --resume to go on with its run");
  }
}

void run_train(const TrainOptions& options) {
  auto config = options.config;
  const auto settings =
      std::visit([](const auto& c) -> train::TrainingSettings { return c; }, config);
  const std::vector<fs::path> weights =
      std::visit([&](auto& c) { return prepare(c, options.resume); }, config);
  std::vector<fs::path> inputs{options.data, options.config_file};
  inputs.insert(inputs.end(), weights.begin(), weights.end());
  TrainingOutput folder(output_of(options, inputs));
  Progress progress;
  train::StepReport last;
  if (!options.data.empty())
    scene::list_scenes(options.data);  // a wrong folder is told before its files are read
  RunRecord record("train", std::visit([](const auto& c) { return recorded_config(c); }, config),
                   options.seed);
  if (!options.data.empty()) record.add_input(options.data);
  for (const fs::path& file : weights) record.add_input(file);
  if (!options.resume)
    record.save(folder / "run.json");  // marks the folder as a run from the start
  RecentTerm watched = settings.task == train::Task::mono
                           ? RecentTerm("correlation", "correlation", 3, "")
                           : RecentTerm("height_mae", "height error", 2, " m");
  train::TrainingCallbacks callbacks;
  // Of settings that do nothing only a run tells that goes: errors come alone.
  bool told = false;
  callbacks.step = [&](const train::StepReport& r) {
    if (const auto* c = std::get_if<train::TrainConfig>(&config); c && !std::exchange(told, true))
      for (const std::string& text : train::idle_settings(*c)) progress.note(text);
    if (interrupted() && r.step == 1) throw Interrupted{};  // before anything is worth keeping
    folder.add(r);
    watched.add(r);
    last = r;
    progress.update("train", static_cast<double>(r.step) / static_cast<double>(r.steps),
                    fmt::format("step {}/{}  loss {:.4f}  {}  {:.2f} s/step", r.step, r.steps,
                                r.loss, watched.text(), r.seconds));
    return !interrupted();
  };
  callbacks.save = [&](const TensorFile& checkpoint, const TensorFile& network) {
    folder.save(checkpoint, network);
  };
  callbacks.reading = [&](double read) {
    stop_if_interrupted();
    progress.update("read", read);
  };
  callbacks.note = [](const std::string& text) { log_line(LogLevel::info, text); };
  std::visit(
      [&](const auto& c) {
        train::train(c, options.data, options.seed,
                     options.resume ? folder.checkpoint() : fs::path(), callbacks);
      },
      config);
  if (last.step > 0) {  // else the record of the steps that were done before stays
    record.results() = {
        {"step", last.step}, {"steps", settings.steps}, {watched.name(), watched.mean()}};
    record.save(options.out / "run.json");
  }
  if (interrupted() && last.step < settings.steps) throw Interrupted{};
  std::printf("%td steps done; weights in %s\n", settings.steps,
              (options.out / "weights.safetensors").c_str());
  if (watched.count() > 0)
    std::printf("%s, mean of the last %td steps\n", watched.text().c_str(), watched.count());
}

void apply_preset(train::TrainConfig& config) {
  config.model = nn::model_preset(config.preset);
  static_cast<train::LossConfig&>(config) = train::loss_preset(config.preset);
}

/// As `read_config`; the fields of network and losses start from the preset.
void read_cascade(const Flags& flags, train::TrainConfig& config) {
  const nlohmann::json file = flags.config();
  const std::string where = flags.config_file().string();
  if (file.is_object() && file.contains("preset")) {
    from_json({{"preset", file["preset"]}}, config, where);
    apply_preset(config);
  }
  from_json(file, config, where);
  flags.read(collect_fields(config), [&](const std::string& name) {
    if (name == "preset") apply_preset(config);
  });
}

/// The task that flags or else the configuration file name.
train::Task task_of(const Flags& flags) {
  train::TrainingSettings settings;
  const nlohmann::json file = flags.config();
  if (file.is_object() && file.contains("task"))
    from_json({{"task", file["task"]}}, settings, flags.config_file().string());
  flags.read({collect_fields(settings).front()});
  return settings.task;
}

}  // namespace

void add_train(Program& program) {
  Command& command = program.add("train", "train a network on scenes with true surfaces");
  command.files = {{"weights.safetensors", "the network, its configuration and its origin"},
                   {"checkpoint.safetensors", "all that --resume goes on from"},
                   {"train.jsonl",
                    "a line per step: step, loss, its terms, lr (learning rate), grad_norm (before "
                    "clipping), seconds"},
                   {"run.json", "the record of the run"}};
  command.results = {
      {"step", "the last one done"},
      {"steps", "how many there are"},
      {"height_mae_running", "error of the heights over the last hundred steps, m"},
      {"correlation_running", "of --task mono instead: correlation of its heights with true ones"}};
  const auto options = std::make_shared<TrainOptions>();
  const auto cascade = std::make_shared<train::TrainConfig>();
  const auto mono = std::make_shared<train::MonoTrainConfig>();
  const auto surface = std::make_shared<train::SurfaceTrainConfig>();
  apply_preset(*cascade);
  const std::vector<Mode> modes{{"--task cascade", collect_fields(*cascade)},
                                {"--task mono", collect_fields(*mono)},
                                {"--task surface", collect_fields(*surface)}};
  Flags& flags = command.flags;
  flags.add(collect_fields(*options));
  flags.command().get_option("--overwrite")->excludes(flags.command().get_option("--resume"));
  flags.add_config();
  flags.add(modes[0].fields, "Configuration");
  flags.add(modes[1].fields, "--task mono");
  flags.add(modes[2].fields, "--task surface");
  program.when_called(
      command, [&flags, options, cascade, mono, surface, modes]() -> std::function<void()> {
        flags.read(collect_fields(*options));
        options->config_file = flags.config_file();
        const train::Task task = task_of(flags);
        if (task == train::Task::surface) {
          refuse_others(flags, modes, modes[2]);
          read_config(flags, *surface);
          options->config = *surface;
        } else if (task == train::Task::mono) {
          refuse_others(flags, modes, modes[1]);
          read_config(flags, *mono);
          options->config = *mono;
        } else {
          refuse_others(flags, modes, modes[0]);
          read_cascade(flags, *cascade);
          options->config = *cascade;
        }
        if (flags.print_config())
          return [options] {
            std::visit([](const auto& config) { print_config(config); }, options->config);
          };
        if (std::holds_alternative<train::MonoTrainConfig>(options->config))
          Flags::require("--data", options->data);
        Flags::require("--out", options->out);
        return [options] { run_train(*options); };
      });
}

}  // namespace satsurf::app

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/train/commands.h"

#include "satsurf/core/fields_json.h"
#include "satsurf/rpc/read.h"
#include "satsurf/train/evaluate.h"
#include "satsurf/train/output_folder.h"
#include "satsurf/train/preview.h"
#include "satsurf/train/progress.h"
#include "satsurf/train/record.h"

#include <atomic>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <deque>
#include <numeric>
#include <string>
#include <utility>
#include <variant>

#include <nlohmann/json.hpp>

namespace satsurf::train {
namespace {

namespace fs = std::filesystem;

std::atomic<int> signal_seen{0};

void print_scores(const char* title, const HeightScores& s) {
  std::printf("%-11s MAE %7.3f m  RMSE %7.3f m  median %+8.3f m  NMAD %7.3f m\n", title, s.mae,
              s.rmse, s.median, s.nmad);
  std::printf(
      "%-11s below 1 m %5.1f %%  below 2.5 m %5.1f %%  below 7.5 m %5.1f %%  of all true cells\n",
      "", 100 * s.pag1, 100 * s.pag2_5, 100 * s.pag7_5);
  std::printf(
      "%-11s below 1 m %5.1f %%  below 2.5 m %5.1f %%  below 7.5 m %5.1f %%  of the cells found\n",
      "", 100 * s.pag1_compared, 100 * s.pag2_5_compared, 100 * s.pag7_5_compared);
}

/// A median far larger than the spread is seldom an error of the surface.
void warn_of_datum(const HeightScores& s) {
  // geoid heights are up to 107 m, biases of a reconstruction a few
  constexpr double kSuspicious = 8;
  if (std::abs(s.median) <= kSuspicious || s.nmad >= std::abs(s.median) / 3) return;
  char text[128];
  std::snprintf(text, sizeof text,
                "the heights differ by %.1f m nearly everywhere; is one of them above the geoid?",
                s.median);
  log_line(LogLevel::warning, text);
}

/// The true cells that count; empty for all.
Tensor mask_of(const EvaluateDsmOptions& options, const DsmPair& pair) {
  Tensor mask;
  if (options.mask_water) {
    if (options.classes.empty())
      throw ConfigError("--mask-water: no --classes, wanted the class raster as well");
    const rpc::GeoRaster classes = rpc::read_geo_raster(options.classes);
    if (classes.values.shape() != pair.truth.z.shape())
      throw IoError(options.classes.string() + ": shape " + classes.values.shape().str() +
                    ", wanted the truth's " + pair.truth.z.shape().str());
    mask = not_water(classes.values);
  }
  if (options.seen_by.empty()) return mask;
  if (!pair.frame)
    throw IoError(options.dsm.string() + " and " + options.truth.string() +
                  ": no coordinate system, wanted a UTM zone to place the images of --seen-by");
  std::vector<ImageCamera> cameras;
  for (const fs::path& file : options.seen_by) {
    const rpc::RasterInfo info = rpc::view_info(file, options.image_dirs);
    cameras.push_back({*info.rpc, info.width, info.height});
  }
  Tensor seen = seen_by_two(pair.truth, *pair.frame, cameras);
  for (Index i = 0; i < mask.count(); ++i) seen[i] *= mask[i];
  return seen;
}

/// One term of the objective, on average over the last hundred steps that know it.
class RecentTerm {
 public:
  /// format  of the average, for people
  RecentTerm(std::string term, std::string format)
      : term_(std::move(term)), format_(std::move(format)) {}

  void add(const StepReport& report) {
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

/// The branch that comes with the program, where a new run needs one and names none.
void find_branch(TrainConfig& config, bool resume) {
  if (!resume && config.mono_weights.empty() && needs_branch(config))
    config.mono_found = find_shipped("mono12.safetensors", "monocular weights", "--mono_weights");
}

}  // namespace

void catch_interrupts() {
  struct sigaction action {};
  action.sa_handler = [](int signal) { signal_seen = signal; };
  action.sa_flags = static_cast<int>(SA_RESETHAND);  // the second one kills
  for (const int signal : {SIGINT, SIGTERM, SIGHUP}) {
    struct sigaction before {};
    sigaction(signal, nullptr, &before);
    if (signal == SIGHUP && before.sa_handler == SIG_IGN) continue;  // nohup
    sigaction(signal, &action, nullptr);
  }
}

bool interrupted() { return signal_seen != 0; }
int interrupt_signal() { return signal_seen; }

void run_simulate(const SimulateOptions& options) {
  SimulateConfig config = options.config;
  check_config(config);
  RunRecord record("simulate", to_json(config), config.seed);
  config.heights = false;  // per-pixel heights are not written
  OutputFolder folder = OutputFolder::staged(options.out, options.overwrite, {options.config_file});
  Progress progress;
  for (Index i = 0; i < config.scenes; ++i) {
    if (interrupted()) throw Interrupted{};
    progress.update("simulate", static_cast<double>(i) / static_cast<double>(config.scenes));
    const SimulatedScene scene = simulate_scene(config, config.seed, i);
    char name[32];
    std::snprintf(name, sizeof name, "SIM_%03td", i + 1);
    write_scene(scene, folder.path(), name);
    double worst = 0;
    for (const SimulatedView& v : scene.views) worst = std::max(worst, v.rpc_max_px);
    record.results()[name] = {{"kind", scene.kind}, {"gsd", scene.gsd}, {"rpc_max_px", worst}};
  }
  progress.update("simulate", 1);
  record.save(folder / "run.json");
  folder.commit();
  std::printf("%td scene%s of %td images written to %s\n", config.scenes,
              config.scenes == 1 ? "" : "s", config.views, options.out.c_str());
}

void run_train(const TrainOptions& options) {
  const auto settings =
      std::visit([](const auto& c) -> TrainingSettings { return c; }, options.config);
  OutputFolder folder =
      options.resume ? OutputFolder::in_place(options.out)
                     : OutputFolder::staged(options.out, options.overwrite,
                                            {options.data, settings.init, options.config_file});
  Progress progress;
  StepReport last;
  list_scenes(options.data);  // a wrong folder is told before its files are read
  RunRecord record("train", std::visit([](const auto& c) { return to_json(c); }, options.config),
                   options.seed);
  record.add_input(options.data);
  if (!settings.init.empty()) record.add_input(settings.init);
  if (!options.resume)
    record.save(folder / "run.json");  // marks the folder as a run from the start
  RecentTerm watched = settings.task == "mono" ? RecentTerm("correlation", "correlation %.3f")
                                               : RecentTerm("height_mae", "height error %.2f m");
  const auto step = [&](const StepReport& r) {
    if (interrupted() && r.step == 1) throw Interrupted{};  // before anything is worth keeping
    watched.add(r);
    last = r;
    char text[160];
    std::snprintf(text, sizeof text, "step %td/%td  loss %.4f  %s  %.2f s/step", r.step, r.steps,
                  r.loss, watched.text().c_str(), r.seconds);
    progress.update("train", static_cast<double>(r.step) / static_cast<double>(r.steps), text);
    return !interrupted();
  };
  const auto reading = [&](double read) {
    if (interrupted()) throw Interrupted{};
    progress.update("read", read);
  };
  std::visit(
      [&](auto c) {
        if constexpr (std::is_same_v<decltype(c), TrainConfig>) find_branch(c, options.resume);
        train(c, options.data, std::move(folder), options.seed, options.resume, step, reading);
      },
      options.config);
  record.results() = {
      {"step", last.step}, {"steps", settings.steps}, {watched.name(), watched.mean()}};
  record.save(options.out / "run.json");
  if (interrupted() && last.step < settings.steps) throw Interrupted{};
  std::printf("%td steps done; weights in %s\n", settings.steps,
              (options.out / "weights.safetensors").c_str());
  if (watched.count() > 0)
    std::printf("%s, mean of the last %td steps\n", watched.text().c_str(), watched.count());
}

void run_evaluate_dsm(const EvaluateDsmOptions& options) {
  const Registration registration = registration_from(options.registration);
  std::vector<fs::path> inputs{options.dsm, options.truth};
  if (!options.classes.empty()) inputs.push_back(options.classes);
  for (const fs::path& file : options.seen_by) {
    const rpc::RasterInfo info = rpc::view_info(file, options.image_dirs);
    inputs.insert(inputs.end(), info.files.begin(), info.files.end());
  }
  check_output_file("--error-map", options.picture, options.overwrite, inputs);
  check_output_file("--json", options.json, options.overwrite, inputs);
  check_distinct({options.picture, options.json});
  const DsmPair pair = load_dsm_pair(options.dsm, options.truth);
  const Tensor mask = mask_of(options, pair);
  DsmComparison c;
  try {
    c = compare_dsm(pair.prediction, pair.truth, registration, mask);
  } catch (const Error& e) {
    throw Error(options.dsm.string() + " and " + options.truth.string() + ": " + e.what());
  }
  if (!options.picture.empty()) write_png(options.picture, error_picture(c.error));
  if (!options.json.empty()) {
    nlohmann::json config{{"dsm", options.dsm},
                          {"truth", options.truth},
                          {"classes", options.classes},
                          {"seen_by", options.seen_by},
                          {"image_dirs", options.image_dirs},
                          {"register", options.registration},
                          {"mask_water", options.mask_water}};
    RunRecord record("evaluate", config, 0);
    for (const fs::path& file : inputs) record.add_input(file);
    record.results() = scores_json(c);
    record.save(options.json);
  }
  std::printf("%td of %td true cells have a predicted height (completeness %.1f %%)\n",
              c.raw.compared, c.raw.truth, 100 * c.raw.completeness);
  print_scores("raw", c.raw);
  if (registration != Registration::none) {
    std::printf("registered by east %+.2f m, north %+.2f m, up %+.3f m\n", c.shift[0], c.shift[1],
                c.shift[2]);
    print_scores("registered", c.registered);
  }
  warn_of_datum(c.raw);
}

}  // namespace satsurf::train

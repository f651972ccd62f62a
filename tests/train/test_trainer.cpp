// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/record.h"
#include "satsurf/core/fields_json.h"
#include "satsurf/core/parallel.h"
#include "satsurf/core/safetensors.h"
#include "satsurf/core/version.h"
#include "satsurf/nn/weights_file.h"
#include "satsurf/scene/simulate/scene.h"
#include "satsurf/train/draw.h"
#include "satsurf/train/loss.h"
#include "satsurf/train/mono_trainer.h"
#include "satsurf/train/stream.h"
#include "satsurf/train/trainer.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <condition_variable>
#include <csignal>
#include <fstream>
#include <iterator>
#include <mutex>
#include <set>
#include <thread>
#include <utility>

#include "tests/temp_folder.h"
#include "tests/train/train_in_folder.h"
#include <doctest/doctest.h>
#include <nlohmann/json.hpp>
#include <sys/resource.h>

using namespace satsurf;
using namespace satsurf::test;
using namespace satsurf::app;
using namespace satsurf::nn;
using namespace satsurf::scene;
using namespace satsurf::train;

namespace {

std::string bytes_of(const std::filesystem::path& path) {
  std::ifstream in(path, std::ios::binary);
  REQUIRE(in.good());
  return {std::istreambuf_iterator<char>(in), {}};
}

TrainConfig tiny(Index steps) {
  TrainConfig c = TrainConfig();
  c.preset = "tiny";
  c.model = nn::model_preset("tiny");
  c.steps = steps;
  c.crop = 32;
  c.lr = 3e-3;
  return c;
}

/// Two small scenes on disk, made once.
const std::filesystem::path& data() {
  static const TempFolder folder("trainer-1");
  static const bool made = [] {
    SimulateConfig c = SimulateConfig();
    c.pixels = 64;
    c.views = 4;
    c.gsd = 0.5;
    for (Index i = 0; i < 2; ++i)
      write_scene(simulate_scene(c, 21, i), folder.path(), "SIM_00" + std::to_string(i + 1));
    return true;
  }();
  REQUIRE(made);
  return folder.path();
}

/// The steps that a run's `train.jsonl` has a line of.
std::vector<Index> journal_steps(const std::filesystem::path& folder) {
  std::vector<Index> steps;
  std::ifstream in(folder / "train.jsonl");
  for (std::string line; std::getline(in, line);)
    steps.push_back(nlohmann::json::parse(line).at("step").get<Index>());
  return steps;
}

std::function<bool(const StepReport&)> stop_after(Index step) {
  return [step](const StepReport& r) { return r.step < step; };
}

}  // namespace

TEST_CASE("five steps, resume and five more are ten steps, byte for byte") {
  const TempFolder folder("trainer-2");
  train_in_folder(tiny(10), data(), folder / "whole", 4);
  train_in_folder(tiny(10), data(), folder / "parts", 4, false, stop_after(5));
  CHECK(bytes_of(folder.path() / "parts" / "checkpoint.safetensors") !=
        bytes_of(folder.path() / "whole" / "checkpoint.safetensors"));
  train_in_folder(tiny(10), data(), folder / "parts", 4, true);
  CHECK(bytes_of(folder.path() / "parts" / "checkpoint.safetensors") ==
        bytes_of(folder.path() / "whole" / "checkpoint.safetensors"));
  CHECK(bytes_of(folder.path() / "parts" / "weights.safetensors") ==
        bytes_of(folder.path() / "whole" / "weights.safetensors"));
  std::ifstream journal(folder.path() / "parts" / "train.jsonl");
  Index lines = 0;
  for (std::string line; std::getline(journal, line);) ++lines;
  CHECK(lines == 10);
}

TEST_CASE("a run killed between its checkpoint and its weights has both once it is resumed") {
  const TempFolder folder("trainer-killed");
  const auto weights = folder.path() / "run" / "weights.safetensors";
  train_in_folder(tiny(4), data(), folder / "run", 4, false, stop_after(2));
  const auto of_step_two = bytes_of(weights);
  train_in_folder(tiny(4), data(), folder / "run", 4, true);
  const auto of_step_four = bytes_of(weights);
  CHECK(of_step_two != of_step_four);
  std::ofstream(weights, std::ios::binary)
      .write(of_step_two.data(), static_cast<std::streamsize>(of_step_two.size()));
  CHECK(bytes_of(weights) == of_step_two);
  train_in_folder(tiny(4), data(), folder / "run", 4, true);  // no step is left
  CHECK(bytes_of(weights) == of_step_four);
}

TEST_CASE("a run goes on with the scenes it was begun with alone") {
  const TempFolder folder("trainer-data"), other("trainer-other");
  scene::SimulateConfig c;
  c.pixels = 96, c.views = 4;
  scene::write_scene(scene::simulate_scene(c, 77, 0), other.path(), "SIM_001");
  const std::vector<scene::Scene> own = training_scenes(data(), 4, {}),
                                  others = training_scenes(other.path(), 4, {});
  CHECK(data_mark(own) == data_mark(training_scenes(data(), 4, {})));
  CHECK(data_mark(own) != data_mark(others));
  train_in_folder(tiny(4), data(), folder / "run", 4, false, stop_after(2));
  const std::string begins = (folder / "run/checkpoint.safetensors").string() + ": trained on " +
                             data_mark(own) + ", and not on ",
                    ends = ", expected the same --data to resume";
  const auto refusal = [&](const std::filesystem::path& with) {
    return error_of<ConfigError>([&] { train_in_folder(tiny(4), with, folder / "run", 4, true); });
  };
  CHECK(refusal(other.path()) == begins + data_mark(others) + ends);
  CHECK(refusal({}) == begins + kMadeUp + ends);
}

TEST_CASE("a resumed run keeps the lines of the steps before, whichever are there") {
  const TempFolder folder("trainer-lines");
  const auto steps_with_four = [&](const std::string& left) {
    write_bytes(folder / "train.jsonl", left);
    TrainingFolder(folder.path()).add({.step = 4, .steps = 9});
    return journal_steps(folder.path());
  };
  CHECK(steps_with_four("") == std::vector<Index>{4});
  CHECK(steps_with_four(R"({"step":1}
{"step":3}
{"step":4}
{"step":5}
)") == std::vector<Index>{1, 3, 4});
  CHECK(steps_with_four(R"({"step":1}
{"step":2,"lo
7
{}

{"step":"2"}
{"step":3})") == std::vector<Index>{1, 3, 4});
}

TEST_CASE("a step that finds no room for its line fails, and what there was room for goes") {
  const TempFolder folder("trainer-no-room");
  TrainingFolder full(folder.path());
  full.add({.step = 1, .steps = 9});
  const auto file = folder / "train.jsonl";
  rlimit before{};
  REQUIRE(getrlimit(RLIMIT_FSIZE, &before) == 0);
  const auto handler = std::signal(SIGXFSZ, SIG_IGN);
  const rlimit small{std::filesystem::file_size(file) + 9, before.rlim_max};
  REQUIRE(setrlimit(RLIMIT_FSIZE, &small) == 0);
  const std::string refusal = error_of<IoError>([&] { full.add({.step = 2, .steps = 9}); });
  setrlimit(RLIMIT_FSIZE, &before);
  std::signal(SIGXFSZ, handler);
  CHECK(refusal ==
        file.string() +
            ": cannot be written (File too large), expected a place that can be written");
  TrainingFolder(folder.path()).add({.step = 2, .steps = 9});
  CHECK(journal_steps(folder.path()) == std::vector<Index>{1, 2});
}

TEST_CASE("a checkpoint whose optimiser or mean cannot be that of a run is refused") {
  const TempFolder folder("trainer-senseless");
  TrainConfig config = tiny(4);
  config.average = 0.9;
  train_in_folder(config, data(), folder / "run", 4, false, stop_after(2));
  const auto file = folder.path() / "run" / "checkpoint.safetensors";
  const TensorFile good = load_safetensors(file);
  const auto refusal = [&](const TensorFile& bad) -> std::string {
    save_safetensors(file, bad);
    try {
      train_in_folder(config, data(), folder / "run", 4, true);
    } catch (const IoError& e) {
      return e.what();
    }
    return "accepted";
  };
  const auto with_value = [&](const std::string& prefix, float value) {
    TensorFile bad = good;
    const auto it = std::ranges::find_if(
        bad.tensors, [&](const auto& t) { return t.first.starts_with(prefix); });
    REQUIRE(it != bad.tensors.end());
    it->second = it->second.clone();
    it->second[0] = value;
    return bad;
  };
  CHECK(refusal(with_value("adam.v.", -1)).find("negative") != std::string::npos);
  CHECK(refusal(with_value("adam.m.", NAN)).find("not finite") != std::string::npos);
  for (const float value : {NAN, INFINITY})
    CHECK(refusal(with_value("mean.", value)).find("not finite") != std::string::npos);
  TensorFile other_step = good;
  other_step.metadata["adam.steps"] = "3";
  CHECK(refusal(other_step).find("of step 2, expected that of the optimiser, 3") !=
        std::string::npos);
  other_step.metadata["adam.steps"] = "";
  CHECK(refusal(other_step).find("expected a count") != std::string::npos);
  CHECK(refusal(with_value("adam.m.", -1)) == "accepted");
}

TEST_CASE("one and two threads train the same bytes") {
  const TempFolder folder("trainer-3");
  for (const int n : {1, 2}) {
    set_threads(n);
    train_in_folder(tiny(3), data(), folder / std::to_string(n), 4);
  }
  set_threads(0);
  CHECK(bytes_of(folder.path() / "1" / "checkpoint.safetensors") ==
        bytes_of(folder.path() / "2" / "checkpoint.safetensors"));
}

TEST_CASE("a batch is its samples' mean, the same bytes on any number of threads") {
  const TempFolder folder("trainer-batch");
  TrainConfig c = tiny(4);
  c.batch = 3;
  c.distribution_weight = 1;
  c.height_in_reach = true;
  c.radiometry_views = 0.2;
  c.average = 0.9;
  c.schedule = Schedule::constant;
  train_in_folder(c, data(), folder / "two", 4);
  set_threads(1);
  train_in_folder(c, data(), folder / "one", 4, false, stop_after(2));
  train_in_folder(c, data(), folder / "one", 4, true);
  set_threads(0);
  for (const char* file : {"checkpoint.safetensors", "weights.safetensors"})
    CHECK(bytes_of(folder.path() / "one" / file) == bytes_of(folder.path() / "two" / file));

  // One step of three samples moves the weights as the mean of their gradients says.
  const std::vector<scene::Scene> scenes = training_scenes(data(), 4, {});
  nn::Model model(c.model, 4);
  std::vector<double> sum;
  for (Index i = 0; i < 3; ++i) {
    model.parameters().clear_grads();
    const Crop crop = training_sample(c, scenes, 4, i);
    training_loss(c, c.model, model.forward(crop.input), crop, {.step = 0, .seed = 4})
        .total.backward();
    std::size_t k = 0;
    for (const auto& e : model.parameters().entries())
      for (const float g : e.var.grad().values()) {
        if (i == 0) sum.push_back(0);
        sum[k++] += static_cast<double>(g) / 3;
      }
  }
  double norm = 0;
  for (const double g : sum) norm += g * g;
  double told = 0;
  nn::Model trained(c.model, 4);
  c.steps = 1;
  train_on_samples(trained, c, [&](Index i) { return training_sample(c, scenes, 4, i); },
                   {.seed = 4},
                   {.step =
                        [&](const StepReport& r) {
                          told = r.grad_norm;
                          return true;
                        },
                    .save = {},
                    .reading = {},
                    .note = {}});
  CHECK(told == doctest::Approx(std::sqrt(norm)).epsilon(1e-4));
}

TEST_CASE("averaged weights lie between those of the steps") {
  const TempFolder folder("trainer-mean");
  TrainConfig c = tiny(6);
  train_in_folder(c, data(), folder / "last", 4);
  c.average = 0.9;
  train_in_folder(c, data(), folder / "mean", 4);
  const TensorFile last = load_safetensors(folder.path() / "last" / "weights.safetensors"),
                   mean = load_safetensors(folder.path() / "mean" / "weights.safetensors"),
                   check = load_safetensors(folder.path() / "mean" / "checkpoint.safetensors");
  Index moved = 0;
  for (const auto& [name, tensor] : last.tensors) {
    const Tensor& trained = check.tensors.at(name);
    for (Index i = 0; i < tensor.count(); ++i) {
      REQUIRE(trained[i] == tensor[i]);  // averaging does not disturb the training
      moved += mean.tensors.at(name)[i] != tensor[i];
    }
    const Tensor& kept = check.tensors.at("mean." + name.substr(std::string("model.").size()));
    for (Index i = 0; i < kept.count(); ++i) REQUIRE(kept[i] == mean.tensors.at(name)[i]);
  }
  CHECK(moved > 100);
}

TEST_CASE("without a data set scenes are made up on the way, the same after an interruption") {
  const TempFolder folder("trainer-stream");
  TrainConfig c = tiny(4);
  c.batch = 2;
  c.scene_uses = 2;
  c.scene_pool = 2;
  c.simulate.pixels = 64;
  c.simulate.views = 4;
  c.simulate.gsd = 0.5;
  train_in_folder(c, {}, folder / "whole", 5);
  train_in_folder(c, {}, folder / "parts", 5, false, stop_after(2));
  train_in_folder(c, {}, folder / "parts", 5, true);
  CHECK(bytes_of(folder.path() / "parts" / "checkpoint.safetensors") ==
        bytes_of(folder.path() / "whole" / "checkpoint.safetensors"));
  SceneStream scenes(c.simulate, 5, 2, 3);
  CHECK(scenes.first(0) == 0);
  CHECK(scenes.first(5) == 2);
  const auto third = scenes.item(2);
  CHECK(scenes.item(2) == third);
  const scene::Scene kept = third->scene(), made = made_up_scene(c.simulate, 5, 2);
  REQUIRE(kept.views.size() == 4);
  REQUIRE(kept.truth.has_value());
  for (std::size_t v = 0; v < 4; ++v) {
    CHECK(std::ranges::equal(kept.views[v].rgb.values(), made.views[v].rgb.values()));
    CHECK(std::ranges::equal(kept.views[v].valid.values(), made.views[v].valid.values()));
  }
  CHECK(std::ranges::equal(kept.classes.values(), made.classes.values()));
  // three colours and what is valid, and a class for every cell of the surface: a byte each
  CHECK(third->bytes() == static_cast<std::size_t>(4 * 4 * 64 * 64 + made.classes.count()));
  scenes.item(40);  // far behind now
  const auto again = scenes.item(2);
  CHECK(again != third);
  CHECK(std::ranges::equal(again->scene().views[0].rgb.values(), kept.views[0].rgb.values()));
  c.simulate.views = 3;
  CHECK_THROWS_WITH_AS(train::train(c, {}, 5, {}, {}),
                       "train: simulate.views is 3, expected more than views, which is 3: one view "
                       "is the target",
                       ConfigError);
}

TEST_CASE(
    "a stream makes nothing twice for the samples of a step, and keeps no more than they want") {
  for (const auto& [uses, pool] : {std::pair<Index, Index>{1, 5}, {4, 8}, {64, 3}, {100, 24}}) {
    CAPTURE(uses);
    Index living = 0, most = 0;
    std::set<Index> made;
    struct Thing {
      Index* living;
      Thing(Index* l) : living(l) { ++*living; }
      Thing(Thing&& other) noexcept : living(std::exchange(other.living, nullptr)) {}
      ~Thing() {
        if (living != nullptr) --*living;
      }
    };
    Stream<Thing> stream(uses, pool, [&](Index number) {
      CHECK(made.insert(number).second);
      return Thing(&living);
    });
    constexpr Index kBatch = 64, kSteps = 30;
    for (Index step = 0; step < kSteps; ++step)
      for (const bool newest :
           {true, false})  // in the worst order: what is ahead is asked for first
        for (Index b = kBatch; b-- > 0;) {
          const Index first = stream.first(step * kBatch + b);
          stream.item(newest ? first + pool - 1 : first);
          most = std::max(most, living);
        }
    CHECK(most <= pool + kBatch / uses + 1);
  }
}

TEST_CASE("a stream's things are made ahead of need, each once, and drawn as if they were not") {
  const int before = threads();
  const auto drawn = [](int threads) {
    set_threads(threads);
    std::mutex mutex;
    std::set<Index> made, elsewhere;
    const std::thread::id here = std::this_thread::get_id();
    std::vector<Index> out;
    {
      Stream<Index> stream(3, 4, [&](Index number) {
        const std::lock_guard lock(mutex);
        CHECK(made.insert(number).second);
        if (std::this_thread::get_id() != here) elsewhere.insert(number);
        return number;
      });
      for (Index sample = 0; sample < 60; ++sample) {
        Rng rng = Rng(7).fork(static_cast<std::uint64_t>(sample));
        out.push_back(*stream.draw(sample, rng));
        CHECK(out.back() >= stream.first(sample));
        CHECK(out.back() < stream.first(sample) + 4);
        std::this_thread::sleep_for(std::chrono::milliseconds(1));
      }
    }
    CHECK(elsewhere.empty() == (threads == 1));
    CHECK(*made.rbegin() <= 19 + 4 + 2);
    return out;
  };
  const std::vector<Index> alone = drawn(1);
  if (before > 1) CHECK(drawn(before) == alone);
  set_threads(0);
}

TEST_CASE("where there are several threads, things are made ahead side by side") {
  if (threads() == 1) return;
  std::mutex mutex;
  std::condition_variable arrived;
  int makers = 0;
  bool together = false;
  const std::thread::id here = std::this_thread::get_id();
  {
    Stream<Index> stream(3, 4, [&](Index number) {
      if (std::this_thread::get_id() == here) return number;
      std::unique_lock lock(mutex);
      ++makers;
      arrived.notify_all();
      if (arrived.wait_for(lock, std::chrono::seconds(20), [&] { return makers > 1 || together; }))
        together = true;
      --makers;
      return number;
    });
    Rng rng(7);
    stream.draw(0, rng);
  }
  CHECK(together);
}

TEST_CASE("what fails ahead of need is told to who draws it") {
  Stream<Index> stream(1, 2, [](Index number) {
    if (number > 4) throw ConfigError("number " + std::to_string(number));
    return number;
  });
  const auto all = [&] {
    for (Index sample = 0; sample < 40; ++sample) {
      Rng rng = Rng(7).fork(static_cast<std::uint64_t>(sample));
      stream.draw(sample, rng);
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
  };
  CHECK_THROWS_AS(all(), ConfigError);
}

TEST_CASE("training lowers the error on samples it has not seen") {
  const TempFolder folder("trainer-3");
  std::vector<Scene> scenes;
  for (const std::string& name : list_scenes(data())) scenes.push_back(load_scene(data(), name));
  const TrainConfig config = tiny(80);
  const auto error = [&](const nn::Model& model) {
    const NoGrad no_grad;
    double sum = 0;
    for (Index k = 0; k < 12; ++k) {
      const Crop crop = training_sample(config, scenes, 99, k);
      sum += training_loss(config, model.config(), model.forward(crop.input), crop).height_mae / 12;
    }
    return sum;
  };
  train_in_folder(config, data(), folder.path(), 1);
  const double before = error(nn::Model(config.model, 1)),
               after = error(load_model(folder.path() / "weights.safetensors"));
  CAPTURE(before);
  CHECK(after < 0.85 * before);
}

TEST_CASE("a model comes back from its file, configuration included") {
  const TempFolder folder("trainer-5");
  const nn::Model model(nn::model_preset("tiny"), 9);
  save_model(folder.path() / "m.safetensors", model);
  const nn::Model loaded = load_model(folder.path() / "m.safetensors");
  CHECK(loaded.config() == model.config());
  for (std::size_t k = 0; k < model.parameters().entries().size(); ++k) {
    const Tensor &a = model.parameters().entries()[k].var.value(),
                 &b = loaded.parameters().entries()[k].var.value();
    REQUIRE(std::equal(a.values().begin(), a.values().end(), b.data()));
  }
  save_safetensors(folder.path() / "other.safetensors", TensorFile());
  CHECK_THROWS_WITH_AS(
      load_model(folder.path() / "other.safetensors"),
      ((folder.path() / "other.safetensors").string() +
       ": not a satsurf model, expected metadata format = satsurf-1 and its configuration")
          .c_str(),
      IoError);
}

TEST_CASE("weights say where they come from") {
  const TempFolder folder("trainer-8");
  train_in_folder(tiny(2), data(), folder / "out", 4);
  for (const char* name : {"out/weights.safetensors", "out/checkpoint.safetensors"}) {
    const auto metadata = load_safetensors(folder / name).metadata;
    CHECK(metadata.at("seed") == "4");
    CHECK(metadata.at("step") == "2");
    CHECK(metadata.at("scenes") == "2");
    CHECK(metadata.at("train") == to_json(tiny(2)).dump());
    CHECK(metadata.at("version") == program_version());
    CHECK(metadata.at("git") == program_git_hash());
  }
}

TEST_CASE("samples are a function of seed and step") {
  std::vector<Scene> scenes;
  for (const std::string& name : list_scenes(data())) scenes.push_back(load_scene(data(), name));
  const TrainConfig config = tiny(1);
  const Crop a = training_sample(config, scenes, 7, 3), b = training_sample(config, scenes, 7, 3),
             c = training_sample(config, scenes, 7, 4);
  const auto pixels = [](const Crop& crop) {
    const auto v = crop.input.sources[0].rgb.values();
    return std::vector<float>(v.begin(), v.end());
  };
  CHECK(pixels(a) == pixels(b));
  CHECK(pixels(a) != pixels(c));
}

TEST_CASE("what a seed draws stays what it is") {
  Rng rng(7);
  CHECK(shuffled(8, rng) == std::vector<Index>{5, 6, 3, 4, 1, 0, 2, 7});
  for (int k = 0; k < 200; ++k) {
    const double middle = window_middle(32, 100, rng);
    REQUIRE(middle >= 15.5);
    REQUIRE(middle < 83.5);
  }
  CHECK(window_middle(64, 64, rng) == 31.5);
  CHECK(window_middle(96, 64, rng) == 31.5);
}

TEST_CASE("windows that no memory holds are refused before anything is read") {
  TrainConfig config = tiny(1);
  config.crop = 1 << 20;
  CHECK(test::error_of<Error>([&] {
          train::train(config, "nowhere", 1, {}, {});
        }).starts_with("train: windows of 1048576 px of 4 images need about "));
}

TEST_CASE("settings without effect are told") {
  TrainConfig config = tiny(1);  // has no monocular branch
  CHECK(idle_settings(config) ==
        std::vector<std::string>{
            "no perceptual loss: lpips_weights names no file",
            "no correlation with relative heights: the network has no monocular branch"});
  config.geo_target = GeoTarget::dsm;
  config.lpips_weights = "l.safetensors";
  CHECK(idle_settings(config).empty());
  config.mono_weights = "m.safetensors";
  CHECK(idle_settings(config) ==
        std::vector<std::string>{"mono_weights is not read: the network has no monocular branch"});
  config.model.mono = nn::MonoBranch::own;
  config.geo_target = GeoTarget::mono;
  CHECK(idle_settings(config).empty());
}

TEST_CASE("resuming with another configuration or seed is refused") {
  const TempFolder folder("trainer-6");
  train_in_folder(tiny(1), data(), folder.path(), 4);
  const auto refusal = [&](const TrainConfig& config, std::uint64_t seed) {
    return error_of<ConfigError>(
        [&] { train_in_folder(config, data(), folder.path(), seed, true); });
  };
  const std::string start = (folder / "checkpoint.safetensors").string() +
                            ": made with another configuration, expected the same to resume; ";
  CHECK(refusal(tiny(2), 5) == start + "seed: saved 4 vs given 5, steps: saved 1 vs given 2");
  TrainConfig other = tiny(1);
  other.stage_weight[1] = 3;
  CHECK(refusal(other, 4) == start + "stage_weight.1: saved 1.0 vs given 3.0");
  other = tiny(1);
  other.preset = "base8", other.model = nn::model_preset("base8");
  CHECK(refusal(other, 4).ends_with(" more"));
  TrainConfig odd = tiny(1);
  odd.crop = 40;
  CHECK_THROWS_WITH_AS(train_in_folder(odd, data(), folder.path(), 4),
                       "train: crop is 40, expected a multiple of 16", ConfigError);
}

TEST_CASE("a network with more parts starts from one with fewer") {
  const TempFolder folder("trainer-init");
  train_in_folder(tiny(2), data(), folder / "part", 4);
  TrainConfig whole = tiny(1);
  whole.preset = "tiny_full";
  whole.model = nn::model_preset("tiny_full");
  whole.init = (folder / "part" / "weights.safetensors").string();
  whole.lr = 0;  // what it starts from is what it writes
  CHECK(needs_branch(whole));
  CHECK_THROWS_AS(train_in_folder(whole, data(), folder / "no", 4), ConfigError);

  TensorFile mono;
  store_mono(mono, nn::Mono(whole.model.mono_net, 5));
  save_safetensors(folder / "mono.safetensors", mono);
  whole.mono_weights = (folder / "mono.safetensors").string();
  train_in_folder(whole, data(), folder / "out", 4);
  const TensorFile part = load_safetensors(whole.init),
                   out = load_safetensors(folder / "out" / "weights.safetensors");
  CHECK(out.tensors.size() > part.tensors.size());
  CHECK(out.metadata.at("train").find("\"mono_weights\":\"mono.safetensors\"") !=
        std::string::npos);  // whoever gets the weights need not know our folders
  const auto holds = [&](const std::string& name, const Tensor& expected) {
    INFO(name);
    REQUIRE(out.tensors.contains(name));
    const Tensor& got = out.tensors.at(name);
    REQUIRE(got.shape() == expected.shape());
    CHECK(std::equal(got.values().begin(), got.values().end(), expected.data()));
  };
  for (const auto& [name, tensor] : part.tensors) holds(name, tensor);
  for (const auto& [name, tensor] : mono.tensors) holds(kModelPrefix + name, tensor);

  whole.init = (folder / "out" / "weights.safetensors").string();
  CHECK_FALSE(needs_branch(whole));
  CHECK(error_of<ConfigError>([&] {
          train_in_folder(whole, data(), folder / "no", 4);
        }).ends_with("has a monocular branch already, expected one of them"));
  whole.mono_weights.clear();
  train_in_folder(whole, data(), folder / "again", 4);
  whole.model.base = 6;
  CHECK_THROWS_AS(train_in_folder(whole, data(), folder / "no", 4), IoError);
}

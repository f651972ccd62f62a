// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/adamw.h"
#include "satsurf/nn/weights_file.h"
#include "satsurf/scene/dataset.h"
#include "satsurf/scene/simulate/scene.h"
#include "satsurf/train/loss.h"
#include "satsurf/train/trainer.h"

#include <algorithm>
#include <vector>

#include "tests/temp_folder.h"
#include "tests/train/train_in_folder.h"
#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::scene;
using namespace satsurf::test;
using namespace satsurf::train;

namespace {

TrainConfig tiny(Index steps) {
  TrainConfig c;
  c.preset = "tiny";
  c.model = nn::model_preset("tiny");
  c.steps = steps;
  c.crop = 32;
  return c;
}

/// A scene of four small images as a folder, and as it is read from there.
struct Data {
  TempFolder folder{"own-samples-data"};
  std::vector<Scene> scenes;

  Data() {
    SimulateConfig c;
    c.pixels = 64;
    c.views = 4;
    c.gsd = 0.5;
    write_scene(simulate_scene(c, 21, 0), folder.path(), "SIM_001");
    scenes.push_back(load_scene(folder.path(), "SIM_001"));
  }
};

bool same(const nn::Model& a, const nn::Model& b) {
  return std::ranges::equal(
      a.parameters().entries(), b.parameters().entries(), [](const auto& x, const auto& y) {
        return x.name == y.name &&
               std::ranges::equal(x.var.value().values(), y.var.value().values());
      });
}

}  // namespace

TEST_CASE("own samples train the same bits as the folder they are of") {
  const Data data;
  const TempFolder out("own-samples-1");
  const TrainConfig config = tiny(3);
  const nn::Model expected =
      train::train(config, data.folder.path(), 4, {}, keep_in(out / "folder"));
  nn::Model model(config.model, 4);
  const auto sample = [&](Index step) { return training_sample(config, data.scenes, 4, step); };
  train_on_samples(model, config, sample, {.seed = 4, .scenes = 1, .data = data_mark(data.scenes)},
                   keep_in(out / "own"));
  CHECK(same(model, expected));
  CHECK(same(model, nn::load_model(out / "own" / "weights.safetensors")));
  for (const char* name : {"checkpoint.safetensors", "weights.safetensors"}) {
    CAPTURE(name);
    CHECK(read_bytes(out / "own" / name) == read_bytes(out / "folder" / name));
  }
}

TEST_CASE("training on own samples starts from the model given, stops when told and goes on") {
  const Data data;
  const TempFolder out("own-samples-2");
  const TrainConfig config = tiny(4);
  std::vector<Index> asked;
  const auto sample = [&](Index step) {
    asked.push_back(step);
    return training_sample(config, data.scenes, 9, step);
  };
  nn::Model whole(config.model, 1);
  const nn::Model untrained(config.model, 1);
  train_on_samples(whole, config, sample);
  CHECK(asked == std::vector<Index>{0, 1, 2, 3});
  CHECK_FALSE(same(whole, untrained));

  asked.clear();
  nn::Model first(config.model, 1);
  train_on_samples(first, config, sample, {},
                   keep_in(out / "run", [](const StepReport& r) { return r.step < 2; }));
  CHECK(asked == std::vector<Index>{0, 1});
  CHECK_FALSE(same(first, whole));
  nn::Model second(config.model, 7);  // all of it comes from the checkpoint
  train_on_samples(second, config, sample, {.checkpoint = out / "run" / "checkpoint.safetensors"},
                   keep_in(out / "run"));
  CHECK(asked == std::vector<Index>{0, 1, 2, 3});
  CHECK(same(second, whole));
  const std::string journal = read_bytes(out / "run" / "train.jsonl");
  CHECK(std::ranges::count(journal, '\n') == 4);
}

TEST_CASE("a run takes AdamW's steps, with the rate, the clip and the decay of its settings") {
  const Data data;
  TrainConfig config = tiny(10);
  config.warmup = 0.3, config.clip = 0.5, config.weight_decay = 0.2;
  const auto sample = [&](Index step) { return training_sample(config, data.scenes, 4, step); };
  const auto rate = [&](Index step) {
    return config.schedule == Schedule::constant && step >= 3
               ? config.lr
               : nn::one_cycle_lr(config.lr, 0.3, step, 10);
  };
  for (const Schedule schedule : {Schedule::one_cycle, Schedule::constant}) {
    config.schedule = schedule;
    std::vector<double> rates, norms;
    TrainingCallbacks callbacks;
    callbacks.step = [&](const StepReport& r) {
      rates.push_back(r.lr), norms.push_back(r.grad_norm);
      return true;
    };
    nn::Model trained(config.model, 1), by_hand(config.model, 1);
    train_on_samples(trained, config, sample, {.seed = 4}, callbacks);

    nn::AdamW optimiser(by_hand.parameters(), {.weight_decay = config.weight_decay});
    REQUIRE(rates.size() == 10);
    for (Index step = 0; step < 10; ++step) {
      CAPTURE(step);
      by_hand.parameters().clear_grads();
      const Crop crop = sample(step);
      const auto stages =
          by_hand.forward(crop.input, {}, nullptr, wanted_by(config, crop.target.has_value()));
      training_loss(config, config.model, stages, crop, {.step = step, .seed = 4}).total.backward();
      const auto at = static_cast<std::size_t>(step);
      CHECK(norms[at] == nn::clip_gradient_norm(by_hand.parameters(), config.clip));
      CHECK(norms[at] > 2 * config.clip);  // else clipping would not show
      CHECK(rates[at] == rate(step));
      optimiser.step(rate(step));
    }
    CHECK(same(trained, by_hand));
    CHECK(rates[0] < rates[3] / 20);
    CHECK((rates[9] < rates[3] / 1000) == (schedule == Schedule::one_cycle));
  }
}

TEST_CASE("the record of own samples tells the network that was trained") {
  const Data data;
  TrainConfig config = tiny(1);
  const auto sample = [&](Index step) { return training_sample(config, data.scenes, 9, step); };
  nn::Model model(config.model, 1);
  config.model = nn::model_preset("base8");
  TensorFile kept;
  TrainingCallbacks callbacks;
  callbacks.save = [&](const TensorFile&, const TensorFile& weights) { kept = weights; };
  train_on_samples(model, config, sample, {}, callbacks);
  const std::string record = kept.metadata.at("train"), network = kept.metadata.at("model");
  CHECK(record.find("\"model\":" + network) != std::string::npos);
}

TEST_CASE("samples that do not fit and settings out of range are refused") {
  const Data data;
  TrainConfig config = tiny(1);
  nn::Model model(config.model, 1);
  const auto odd = [&](Index step) {
    Crop crop = training_sample(config, data.scenes, 9, step);
    crop.input.sources[1].rgb = Tensor({3, 16, 16});
    return crop;
  };
  CHECK_THROWS_AS(train_on_samples(model, config, odd), ShapeError);
  config.lr = 2;
  CHECK_THROWS_AS(train_on_samples(model, config, odd), ConfigError);
}

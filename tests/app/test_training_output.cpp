// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/training_output.h"
#include "satsurf/scene/simulate/scene.h"
#include "satsurf/train/trainer.h"

#include <filesystem>
#include <functional>
#include <utility>

#include "tests/temp_folder.h"
#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::train;
using namespace satsurf::test;
using namespace satsurf::app;

TEST_CASE("a run that fails or stops before its first checkpoint leaves an earlier one alone") {
  const TempFolder scenes("trainer-8"), folder("trainer-7");
  const std::filesystem::path data = scenes.path();
  scene::SimulateConfig small;
  small.pixels = 64, small.views = 4, small.gsd = 0.5;
  scene::write_scene(scene::simulate_scene(small, 21, 0), data, "SIM_001");
  const auto tiny = [](Index steps) {
    TrainConfig c;
    c.preset = "tiny", c.model = nn::model_preset("tiny");
    c.steps = steps, c.crop = 32;
    return c;
  };
  const std::filesystem::path out = folder / "out";
  std::filesystem::create_directories(out);
  write_bytes(out / "run.json", R"({"program": "satsurf", "command": "train"})");
  using Step = std::function<bool(const StepReport&)>;
  const auto train_into = [&](const TrainConfig& config, OutputFolder into, const Step& step = {},
                              bool resume = false) {
    TrainingOutput files(std::move(into));
    TrainingCallbacks callbacks;
    callbacks.step = [&](const StepReport& r) {
      files.add(r);
      return step ? step(r) : true;
    };
    callbacks.save = [&](const TensorFile& checkpoint, const TensorFile& weights) {
      files.save(checkpoint, weights);
    };
    train::train(config, data, 4, resume ? files.checkpoint() : std::filesystem::path(), callbacks);
  };
  const auto again = [&](const TrainConfig& config, const Step& step) {
    train_into(config, OutputFolder::staged(out, true), step);
  };
  const auto untouched = [&] {
    const auto begin = std::filesystem::recursive_directory_iterator(folder.path());
    return std::distance(begin, {}) == 2 && std::filesystem::exists(out / "run.json");
  };
  TrainConfig many = tiny(2), lost = tiny(2);
  many.views = 8;
  lost.init = (folder / "nope.safetensors").string();
  CHECK_THROWS_AS(again(many, {}), IoError);
  CHECK(untouched());
  CHECK_THROWS_AS(again(lost, {}), IoError);
  CHECK(untouched());
  CHECK_THROWS_AS(again(tiny(2), [](const StepReport&) -> bool { throw Error("full"); }), Error);
  CHECK(untouched());

  // after it, what there is can be resumed
  CHECK_THROWS_AS(again(tiny(3),
                        [](const StepReport& r) {
                          if (r.step == 2) throw Error("full");
                          return true;
                        }),
                  Error);
  CHECK(!std::filesystem::exists(out / "run.json"));
  train_into(tiny(3), OutputFolder::in_place(out), {}, true);
  train_into(tiny(3), OutputFolder::staged(folder / "whole", false));
  CHECK(read_bytes(out / "checkpoint.safetensors") ==
        read_bytes(folder / "whole/checkpoint.safetensors"));
}

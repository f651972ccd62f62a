// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/record.h"
#include "satsurf/core/fields_json.h"
#include "satsurf/core/parallel.h"
#include "satsurf/core/symmetry.h"
#include "satsurf/core/version.h"
#include "satsurf/nn/weights_file.h"
#include "satsurf/scene/simulate/scene.h"
#include "satsurf/train/augment.h"
#include "satsurf/train/mono_trainer.h"
#include "satsurf/train/trainer.h"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <set>
#include <vector>

#include "tests/temp_folder.h"
#include "tests/train/train_in_folder.h"
#include <doctest/doctest.h>
#include <nlohmann/json.hpp>

using namespace satsurf;
using namespace satsurf::test;
using namespace satsurf::app;
using namespace satsurf::nn;
using namespace satsurf::scene;
using namespace satsurf::train;

namespace {

MonoTrainConfig tiny(Index steps) {
  MonoTrainConfig c;
  c.mono.base = 3;
  c.steps = steps;
  c.crop = 64;
  c.batch = 2;
  return c;
}

/// Two small scenes on disk, made once.
const std::filesystem::path& data() {
  static const TempFolder folder("mono-1");
  static const bool made = [] {
    SimulateConfig c = SimulateConfig();
    c.pixels = 96;
    c.views = 3;
    c.gsd = 0.5;
    c.kinds = {scene::SceneKind::city, scene::SceneKind::suburb};
    for (Index i = 0; i < 2; ++i)
      write_scene(simulate_scene(c, 31, i), folder.path(), "SIM_00" + std::to_string(i + 1));
    return true;
  }();
  REQUIRE(made);
  return folder.path();
}

const std::vector<Scene>& scenes() {
  static const std::vector<Scene> all = training_scenes(data(), 1, {});
  return all;
}

bool equal(const Tensor& a, const Tensor& b) {
  return a.shape() == b.shape() &&
         std::equal(a.values().begin(), a.values().end(), b.data(),
                    [](float x, float y) { return x == y || (std::isnan(x) && std::isnan(y)); });
}

}  // namespace

TEST_CASE("monocular training: five steps, resume and five more are ten steps, byte for byte") {
  const TempFolder folder("mono-2");
  train_in_folder(tiny(10), data(), folder / "whole", 4);
  train_in_folder(tiny(10), data(), folder / "parts", 4, false,
                  [](const StepReport& r) { return r.step < 5; });
  CHECK(read_bytes(folder / "parts/checkpoint.safetensors") !=
        read_bytes(folder / "whole/checkpoint.safetensors"));
  set_threads(1);  // and on another number of threads
  train_in_folder(tiny(10), data(), folder / "parts", 4, true);
  set_threads(0);
  for (const char* name : {"checkpoint.safetensors", "weights.safetensors"})
    CHECK(read_bytes(folder / "parts" / name) == read_bytes(folder / "whole" / name));
  std::ifstream journal(folder / "parts/train.jsonl");
  Index lines = 0;
  for (std::string line; std::getline(journal, line);) {
    const auto j = nlohmann::ordered_json::parse(line);
    CHECK(j["step"] == ++lines);
    std::vector<std::string> keys;
    for (const auto& item : j.items()) keys.push_back(item.key());
    CHECK(keys == std::vector<std::string>{"step", "loss", "ssi", "gradient", "correlation", "lr",
                                           "grad_norm", "seconds"});
    CHECK(j["loss"].get<double>() ==
          doctest::Approx(j["ssi"].get<double>() + 0.5 * j["gradient"].get<double>()));
  }
  CHECK(lines == 10);
}

TEST_CASE("monocular weights come back with their configuration, and say where they come from") {
  const TempFolder folder("mono-3");
  train_in_folder(tiny(2), data(), folder / "out", 4);
  const auto path = folder / "out/weights.safetensors";
  const nn::Mono mono = load_mono(path);
  CHECK(mono.config() == tiny(2).mono);
  const TensorFile file = load_safetensors(path);
  CHECK(file.tensors.size() == mono.parameters().entries().size());
  for (const auto& [name, tensor] : file.tensors) CHECK(name.starts_with("mono."));
  for (const auto& e : mono.parameters().entries())
    CHECK(equal(file.tensors.at("mono." + e.name), e.var.value()));
  CHECK(file.metadata.at("format") == "satsurf-1");
  CHECK(file.metadata.at("mono") == R"({"base":3})");
  CHECK(file.metadata.at("seed") == "4");
  CHECK(file.metadata.at("step") == "2");
  CHECK(file.metadata.at("scenes") == "2");
  CHECK(file.metadata.at("train") == to_json(tiny(2)).dump());
  CHECK(file.metadata.at("git") == program_git_hash());
  CHECK(error_of<IoError>([&] { load_model(path); }) ==
        path.string() +
            ": not a satsurf model, expected metadata format = satsurf-1 and its configuration");

  // one file may hold both networks
  const nn::Model model(nn::model_preset("tiny"), 9);
  TensorFile both = file;
  store_model(both, model);
  CHECK(mono_from(both, "both").parameters().count() == mono.parameters().count());
  CHECK(model_from(both, "both").parameters().count() == model.parameters().count());
  save_model(folder / "model.safetensors", model);
  CHECK(error_of<IoError>([&] { load_mono(folder / "model.safetensors"); }) ==
        (folder / "model.safetensors").string() +
            ": not a satsurf monocular network, expected metadata format = satsurf-1 and its "
            "configuration");
}

TEST_CASE("sixty steps raise the correlation of heights with the truth") {
  const TempFolder folder("mono-4");
  MonoTrainConfig config = tiny(60);
  config.mono.base = 4;
  config.batch = 4;
  config.lr = 0.01;
  config.gradient_weight = 0.1;
  config.radiometry = config.grey_share = 0;
  const auto correlation = [&](const nn::Mono& mono) {  // in windows of another seed
    const NoGrad no_grad;
    double sum = 0;
    for (Index k = 0; k < 10; ++k)
      sum += mono_loss(config, mono, mono_sample(config, scenes(), 77, k)).terms[2].second / 10;
    return sum;
  };
  double last = 0;
  train_in_folder(config, data(), folder / "out", 1, false, [&](const StepReport& r) {
    if (r.step > 50) last += r.term("correlation") / 10;
    return true;
  });
  const double before = correlation(nn::Mono(config.mono, 1)),
               after = correlation(load_mono(folder / "out/weights.safetensors"));
  CAPTURE(before);
  CAPTURE(last);
  CHECK(after > 0.4);
  CHECK(after > before + 0.3);
  CHECK(std::abs(after - last) < 0.2);  // what the steps report
}

TEST_CASE("monocular samples are a function of seed and step, and true") {
  MonoTrainConfig config = tiny(1);
  const auto a = mono_sample(config, scenes(), 7, 3), b = mono_sample(config, scenes(), 7, 3),
             c = mono_sample(config, scenes(), 7, 4);
  CHECK(a.image.shape() == Shape{2, 3, 64, 64});
  CHECK(a.truth.shape() == Shape{2, 64, 64});
  CHECK(equal(a.image, b.image));
  CHECK(equal(a.truth, b.truth));
  CHECK(!equal(a.image, c.image));
  CHECK(!equal(a.truth, c.truth));
  for (Index i = 0; i < a.valid.count(); ++i)
    REQUIRE((a.valid[i] == 1 ? std::isfinite(a.truth[i]) : a.valid[i] == 0));
  // without other radiometry, a window and its heights are somewhere in an image, turned somehow
  config.radiometry = config.grey_share = 0;
  config.batch = 1;
  config.crop = 96;  // the whole image: but one window of each view
  struct Whole {
    Tensor image, truth;
    Index symmetry;
  };
  std::vector<Whole> all;
  for (const Scene& scene : scenes())
    for (const View& view : scene.views) {
      const auto heights = heights_in_view(
          *scene.truth, rpc::fit_localisation(view.rpc, scene.frame, {0, 0, 96, 96}, scene.z_range),
          96, 96);
      for (Index s = 0; s < 8; ++s) {
        const nn::PosedImage v{turned(view.rgb, s), turned(view.valid, s), {}, {}};
        all.push_back({nn::standardised<float>(v), turned(heights, s), s});
      }
    }
  std::set<Index> seen;
  for (Index step = 0; step < 40; ++step) {
    const auto sample = mono_sample(config, scenes(), 7, step);
    const auto same =
        std::ranges::find_if(all, [&](const Whole& w) { return equal(w.image, sample.image); });
    REQUIRE(same != all.end());
    seen.insert(same->symmetry);
    for (Index i = 0; i < sample.truth.count(); ++i)
      REQUIRE((sample.valid[i] == 0 || same->truth[i] == sample.truth[i]));
  }
  CHECK(seen.size() == 8);
}

TEST_CASE("correlation of relative heights") {
  const Tensor truth = Tensor::from({2, 1, 4}, {1, 2, 3, std::nanf(""), 5, 5, 5, 5}),
               valid = Tensor::from({2, 1, 4}, {1, 1, 1, 0, 1, 1, 1, 1});
  const auto of = [&](std::vector<float> first) {
    first.insert(first.end(), {1, 2, 3, 4});  // against a flat map: not counted
    return mono_correlation(Tensor::from({2, 1, 4}, first), truth, valid);
  };
  CHECK(of({10, 20, 30, -500}) == doctest::Approx(1));
  CHECK(of({-1, -2, -3, 0}) == doctest::Approx(-1));
  CHECK(of({1, 0, 1, 7}) == doctest::Approx(0));
  CHECK(std::isnan(of({2, 2, 2, 2})));
  CHECK_THROWS_WITH_AS(
      mono_correlation(truth, truth, Tensor({2, 1, 5})),
      "mono_correlation: valid has shape [2,1,5], expected [N H W] with N=2 from height, "
      "H=1 from height, W=4 from height",
      ShapeError);
}

TEST_CASE("monocular training refuses what it cannot do") {
  const TempFolder folder("mono-5");
  const auto refusal = [&](const MonoTrainConfig& config) {
    return error_of<ConfigError>([&] { train_in_folder(config, data(), folder / "no", 4); });
  };
  MonoTrainConfig odd = tiny(1), other = tiny(1), none = tiny(1);
  odd.crop = 48;
  other.task = Task::cascade;
  none.batch = 0;
  CHECK(refusal(odd) == "train: crop is 48, expected a multiple of 32");
  CHECK(refusal(other) == "train: task is cascade, expected mono");
  CHECK(refusal(none).starts_with("train: batch"));
  TrainConfig cascade = TrainConfig();
  cascade.task = Task::mono;
  CHECK_THROWS_WITH_AS(train_in_folder(cascade, data(), folder / "no", 4),
                       "train: task is mono, expected cascade", ConfigError);
}

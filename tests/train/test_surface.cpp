// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/fields_json.h"
#include "satsurf/core/parallel.h"
#include "satsurf/nn/adamw.h"
#include "satsurf/nn/weights_file.h"
#include "satsurf/ops/candidates.h"
#include "satsurf/train/mono_trainer.h"
#include "satsurf/train/scene_stream.h"
#include "satsurf/train/surface_trainer.h"
#include "satsurf/train/trainer.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <set>
#include <vector>

#include "tests/temp_folder.h"
#include "tests/train/train_in_folder.h"
#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::test;
using namespace satsurf::train;

namespace {

/// A cascade that has learned nothing, in a file.
const std::filesystem::path& cascade() {
  static const TempFolder folder("surface-1");
  static const std::filesystem::path file = [] {
    nn::save_model(folder / "cascade.safetensors", nn::Model(nn::model_preset("tiny"), 3));
    return folder / "cascade.safetensors";
  }();
  return file;
}

SurfaceTrainConfig tiny(Index steps) {
  SurfaceTrainConfig c;
  c.surface.base = 3;
  c.cascades = {cascade()};
  c.steps = steps;
  c.crop = 48;
  c.batch = 2;
  c.simulate.pixels = 96;
  c.simulate.views = 3;
  c.simulate.gsd = 0.5;
  c.simulate.water = 0;
  c.simulate.kinds = {scene::SceneKind::city, scene::SceneKind::suburb};
  c.scene_uses = 8;
  c.scene_pool = 2;
  return c;
}

/// A lesson in which the second candidate is right wherever the images agree about it.
SurfaceLesson made_up(Index S) {
  Rng rng(9);
  const Index P = S * S;
  SurfaceLesson lesson{
      {Tensor({nn::kSurfaceCandidates, S, S}), Tensor({nn::kSurfacePlanes, S, S}), 0.5},
      Tensor({S, S}),
      Tensor({S, S}, 1.f)};
  for (Index i = 0; i < P; ++i) {
    const bool second = (i / S / 8 + i % S / 8) % 2 == 0;
    for (Index k = 0; k < nn::kSurfaceCandidates; ++k)
      lesson.input.candidates[k * P + i] = k == 1 ? 6.f : 0.f;
    lesson.input.planes[i] = second ? 1.f : 0.f;
    lesson.input.planes[P + i] = second ? 0.f : 1.f;
    lesson.truth[i] = (second ? 6.f : 0.f) + 0.1f * static_cast<float>(rng.normal());
  }
  std::fill_n(lesson.input.planes.data() + static_cast<Index>(nn::SurfacePlane::views) * P, P,
              0.75F);
  lesson.weight[3] = 0, lesson.truth[3] = std::nanf("");
  return lesson;
}

}  // namespace

TEST_CASE("surface training: resumed on other threads it is the same, byte for byte") {
  const TempFolder folder("surface-2");
  train_in_folder(tiny(6), {}, folder / "whole", 4);
  train_in_folder(tiny(6), {}, folder / "parts", 4, false,
                  [](const StepReport& r) { return r.step < 3; });
  CHECK(read_bytes(folder / "parts/checkpoint.safetensors") !=
        read_bytes(folder / "whole/checkpoint.safetensors"));
  set_threads(1);
  train_in_folder(tiny(6), {}, folder / "parts", 4, true);
  set_threads(0);
  CHECK(read_bytes(folder / "parts/checkpoint.safetensors") ==
        read_bytes(folder / "whole/checkpoint.safetensors"));
  CHECK(read_bytes(folder / "parts/train.jsonl").size() > 0);
  // the files work by themselves
  const auto network = nn::load_surface(folder / "whole/weights.safetensors");
  REQUIRE(network);
  CHECK(network->config().base == 3);
  CHECK(nn::load_model(folder / "whole/weights.safetensors").config() ==
        nn::load_model(cascade()).config());
  // whoever gets the weights need not know our folders; resuming asks whether it is the same file
  const auto configuration = [&](const std::string& name) {
    return load_safetensors(folder / ("whole/" + name)).metadata.at("train");
  };
  CHECK(configuration("weights.safetensors").find(R"("cascades":["cascade.safetensors"])") !=
        std::string::npos);
  CHECK(configuration("checkpoint.safetensors") == to_json(tiny(6)).dump());
}

TEST_CASE("how images are made to look is a setting of the networks that are shown some") {
  for (const char* field : {"grey_share", "radiometry"}) {
    CAPTURE(field);
    CHECK(to_json(TrainConfig()).contains(field));
    CHECK(to_json(MonoTrainConfig()).contains(field));
    CHECK_FALSE(to_json(SurfaceTrainConfig()).contains(field));
  }
}

TEST_CASE("the surface network learns which candidate the images agree about") {
  SurfaceTrainConfig config = tiny(1);
  const SurfaceLesson lesson = made_up(48);
  nn::SurfaceModel network(config.surface, 2);
  const double before = surface_loss(config, network, lesson).terms[0].second;
  CHECK(surface_loss(config, network, lesson).terms[1].second == doctest::Approx(3).epsilon(0.05));
  nn::AdamW optimiser(network.parameters(), {});
  for (int step = 0; step < 150; ++step) {
    network.parameters().clear_grads();
    surface_loss(config, network, lesson).total.backward();
    optimiser.step(5e-3);
  }
  const double after = surface_loss(config, network, lesson).terms[0].second;
  CHECK(before > 1);
  CHECK(after < 0.5);
}

TEST_CASE("the second network alone learns how large errors are") {
  SurfaceTrainConfig config = tiny(1);
  config.surface.sigma_hidden = 16;
  const SurfaceLesson lesson = made_up(48);
  nn::SurfaceModel network(config.surface, 2);
  const auto learn = [&](Learn what, int steps, double rate, const auto& check) {
    config.learn = what;
    nn::AdamW optimiser(network.parameters(), {});
    for (int step = 0; step < steps; ++step) {
      network.parameters().clear_grads();
      surface_loss(config, network, lesson).total.backward();
      check();
      optimiser.step(rate);
    }
  };
  learn(Learn::surface, 60, 1e-2, [] {});
  const nn::RefinedSurface before = nn::refined(network, lesson.input);
  const double unit = lesson.input.interval;
  const auto within = [&](const nn::RefinedSurface& made, float sigmas) {
    double in = 0, known = 0;
    for (Index i = 0; i < lesson.truth.count(); ++i) {
      REQUIRE(made.heights[i] == before.heights[i]);
      if (!(lesson.weight[i] > 0)) continue;
      known += 1;
      in += std::abs(made.heights[i] - lesson.truth[i]) <= sigmas * made.sigma[i] ? 1 : 0;
    }
    return in / known;
  };
  // As few as possible within one, as many as possible within two.
  const auto gain = [&](const nn::RefinedSurface& made) {
    return config.within_two * within(made, 2) - within(made, 1);
  };
  learn(Learn::sigma, 200, 3e-3, [&] {
    for (const auto& e : network.parameters().entries())
      REQUIRE(e.var.grad().empty() == !e.name.starts_with("sigma."));
  });
  const nn::RefinedSurface after = nn::refined(network, lesson.input);
  MESSAGE("within one and two before: ", within(before, 1), " ", within(before, 2),
          ", after: ", within(after, 1), " ", within(after, 2));
  CHECK(gain(after) > gain(before) + 0.1);
  CHECK(within(after, 2) > 0.85);
  CHECK(within(after, 1) < 0.85);
  const nn::SurfaceOutput<float> said = nn::mean_of_looks(network, lesson.input);
  const Tensor heights =
      chosen_height(said.logits, said.residual, lesson.input.candidates, nn::kSurfaceReach * unit)
          .value();
  CHECK(surface_loss(config, network, lesson).total.value().item() ==
        sigma_loss(heights, network.net().log_scale(lesson.input, said, heights), lesson.truth,
                   lesson.weight, unit, nn::kSigmaOfScale, config.within_two)
            .value()
            .item());
}

TEST_CASE("what is finished stays as it is while expected errors are learned") {
  const TempFolder folder("surface-sigma");
  SurfaceTrainConfig config = tiny(1);
  config.learn = Learn::sigma;
  CHECK(error_of<ConfigError>([&] { train_in_folder(config, {}, folder / "no", 4); }) ==
        "train: learn is sigma and surface.sigma_hidden is 0, expected 1 or more");
  const nn::SurfaceModel one({.base = 3}, 5), two({.base = 3, .sigma_hidden = 8}, 5);
  const SurfaceLesson lesson = made_up(32);
  const nn::RefinedSurface a = nn::refined(one, lesson.input), b = nn::refined(two, lesson.input);
  Index other = 0;
  for (Index i = 0; i < a.heights.count(); ++i) {
    REQUIRE(a.heights[i] == b.heights[i]);
    REQUIRE(a.sigma[i] == a.doubt[i]);
    REQUIRE(a.doubt[i] == b.doubt[i]);
    other += a.sigma[i] != b.sigma[i] ? 1 : 0;
  }
  CHECK(other > 1000);
}

TEST_CASE("cells that fewer than two images show teach nothing") {
  const SurfaceTrainConfig config = tiny(1);
  const nn::SurfaceModel network(config.surface, 2);
  SurfaceLesson lesson = made_up(32);
  const Index P = lesson.truth.count();
  float* views = lesson.input.planes.data() + static_cast<Index>(nn::SurfacePlane::views) * P;
  const auto total = [&] {
    return static_cast<double>(surface_loss(config, network, lesson).total.value().item());
  };
  std::fill_n(views, P, 0.5F);
  for (Index i = 0; i < P / 2; ++i) views[i] = 0.25F;
  const double before = total();
  for (Index i = 0; i < P / 2; ++i) lesson.truth[i] += 100;
  CHECK(total() == before);
  lesson.truth[P - 1] += 100;
  CHECK(total() > before);
}

TEST_CASE("half of the lessons have the cells that reconstructions have by default") {
  SurfaceTrainConfig config = tiny(1);
  config.simulate.pixels = 64;
  std::vector<nn::Model> cascades;
  cascades.push_back(nn::load_model(cascade()));
  const scene::Scene scene = made_up_scene(config.simulate, 3, 0);
  int of_a_pixel = 0, fine = 0, coarse = 0;
  constexpr int kLessons = 24;
  for (std::uint64_t seed = 0; seed < kLessons; ++seed) {
    const SurfaceLesson lesson = surface_lesson(config, cascades, scene, Rng(seed));
    const Tensor& planes = lesson.input.planes;
    const double cell = std::exp(static_cast<double>(
        planes[static_cast<Index>(nn::SurfacePlane::cell) * planes.dim(1) * planes.dim(2)]));
    CAPTURE(cell);
    CHECK(cell > 0.48);
    CHECK(cell < 1.56);
    if (std::abs(cell - 1) < 0.04) ++of_a_pixel;
    if (cell < 0.9) ++fine;
    if (cell > 1.1) ++coarse;
    REQUIRE(lesson.truth.shape() == Shape{planes.dim(1), planes.dim(2)});
    double known = 0;
    for (const float w : lesson.weight.values()) known += static_cast<double>(w);
    CHECK(known > 0.5 * static_cast<double>(lesson.weight.count()));
  }
  CHECK(of_a_pixel >= kLessons / 4);
  CHECK(fine >= 3);
  CHECK(coarse >= 2);
}

TEST_CASE("a lesson's windows are squares of it in all eight orientations") {
  SurfaceLesson lesson = made_up(20);
  for (Index i = 0; i < 400; ++i) lesson.truth[i] = static_cast<float>(i);
  for (Index i = 0; i < 400; ++i) lesson.input.candidates[i] = lesson.truth[i] + 1;
  for (Index i = 0; i < 400; ++i) lesson.input.planes[i] = 1 / (1 + lesson.truth[i]);
  const KeptLesson kept(lesson);
  // of every cell the planes in 2 bytes, candidates and truth in 4, and the weight in one
  CHECK(kept.bytes() == 400 * (2 * nn::kSurfacePlanes + 4 * nn::kSurfaceCandidates + 4 + 1));
  std::set<std::pair<int, int>> directions;
  for (std::uint64_t seed = 0; seed < 60; ++seed) {
    Rng rng(seed);
    const SurfaceLesson window = kept.window(8, rng);
    REQUIRE(window.truth.shape() == Shape{8, 8});
    for (Index i = 0; i < 64; ++i)
      REQUIRE(window.input.candidates[i] == window.truth[i] + 1);  // turned together
    for (Index i = 0; i < 64; ++i) {
      REQUIRE(std::abs(window.input.planes[i] * (1 + window.truth[i]) - 1) <= 0x1p-11f);
      REQUIRE(window.weight[i] == (window.truth[i] == 3 ? 0 : 1));
    }
    const auto step = [&](Index a, Index b) {
      return static_cast<int>(window.truth[b] - window.truth[a]);
    };
    directions.insert({step(0, 1), step(0, 8)});
  }
  CHECK(directions.size() == 8);
  Rng rng(1);
  CHECK(kept.window(64, rng).truth.shape() == Shape{20, 20});
}

TEST_CASE("surface training refuses what it cannot do") {
  const TempFolder folder("surface-3");
  const auto refusal = [&](const SurfaceTrainConfig& config) {
    return error_of<ConfigError>([&] { train_in_folder(config, {}, folder / "no", 4); });
  };
  SurfaceTrainConfig other = tiny(1), none = tiny(1), alone = tiny(1);
  other.task = Task::mono;
  none.cascades.clear();
  alone.simulate.views = 1;
  CHECK(refusal(other) == "train: task is mono, expected surface");
  CHECK(refusal(none) == "train: no cascades, expected weights of at least one");
  CHECK(refusal(alone) == "train: simulate.views is 1, expected two or more");
}

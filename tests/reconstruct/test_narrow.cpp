// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/weights_file.h"
#include "satsurf/reconstruct/narrow.h"
#include "satsurf/reconstruct/reconstruct.h"

#include <algorithm>
#include <vector>

#include "tests/reconstruct/simulated.h"
#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::reconstruct;

namespace {

scene::Scene village_scene(Index pixels, const rpc::HeightRange& height_range) {
  const test::HeldImages held(test::village(pixels, 3));
  return scene::scene_from_images(held.images(), height_range).scene;
}

}  // namespace

TEST_CASE("a height range that is not generous stays what it is") {
  const nn::Model model(nn::model_preset("tiny"), 3);
  const scene::Scene scene = village_scene(96, test::range_of(test::village(96, 3)));
  CHECK(narrowed_range(model, scene) == scene.z_range);
}

TEST_CASE("a height range that is far too generous is narrowed to what holds the surface") {
  const scene::SimulatedScene made = test::village(320, 3);
  const rpc::HeightRange truth{made.h_min, made.h_max};
  const nn::Model model = nn::load_model(SATSURF_TEST_WEIGHTS);
  for (const auto& [below, above] : {std::pair(0.0, 425.0), {150.0, 420.0}}) {
    CAPTURE(below);
    CAPTURE(above);
    scene::Scene scene = village_scene(320, {truth.low - 2 - below, truth.high + 2 + above});
    const rpc::HeightRange found = scene.frame.heights_from_z(narrowed_range(model, scene)),
                           whole = scene.frame.heights_from_z(scene.z_range);
    CHECK(found.low >= whole.low);
    CHECK(found.high <= whole.high);
    CHECK(found.low <= truth.low);
    CHECK(found.high >= truth.high);
    const double spanned = span_of_hypotheses(model.config(), scene);
    CHECK(found.span() > 0.999 * spanned);  // nothing is given away that costs nothing
    CHECK(found.span() < std::max(spanned, truth.span() + 30) + 1);
    // what was seen to agree before is not taken away
    scene.z_agreed = rpc::HeightRange{scene.z_range.low + 1, scene.z_range.high - 100};
    const rpc::HeightRange kept = narrowed_range(model, scene);
    CHECK(kept.low <= scene.z_agreed->low);
    CHECK(kept.high >= scene.z_agreed->high);
    CHECK(kept.high < scene.z_range.high - 50);
  }
}

TEST_CASE("a range is left alone as far as the hypotheses span it") {
  const nn::Model model(nn::model_preset("tiny"), 3);
  scene::Scene scene = village_scene(96, test::range_of(test::village(96, 3)));
  const double spanned = span_of_hypotheses(model.config(), scene);
  scene.z_range.high = scene.z_range.low + 0.999 * spanned;
  int asked = 0;
  CHECK(narrowed_range(model, scene, [&] { ++asked; }) == scene.z_range);
  CHECK(asked == 0);
  scene.z_range.high = scene.z_range.low + 1.1 * spanned;
  narrowed_range(model, scene, [&] { ++asked; });
  CHECK(asked > 0);
}

TEST_CASE("the plan of a run is what the run does, its heights narrowed alike") {
  const scene::SimulatedScene made = test::village(256, 2);
  const nn::Model model = nn::load_model(SATSURF_TEST_WEIGHTS);
  const test::HeldImages held(made);
  const scene::Scene scene =
      scene::scene_from_images(held.images(), rpc::HeightRange{made.h_min - 300, made.h_max + 200})
          .scene;
  const ReconstructPlan plan = plan_of_run(model, scene, {}),
                        before = plan_reconstruction(model.config(), scene, {});
  const Reconstruction run = reconstruct::reconstruct(model, scene, {});
  CHECK(plan.z_range == run.z_range);
  // the cells are those of the heights that are found
  const Index W = run.dsm.z.dim(1), H = run.dsm.z.dim(0);
  CHECK(plan.grid.step == run.dsm.step);
  CHECK(static_cast<double>(W) ==
        doctest::Approx(static_cast<double>(plan.grid.width)).epsilon(0.1));
  CHECK(static_cast<double>(H) ==
        doctest::Approx(static_cast<double>(plan.grid.height)).epsilon(0.1));
  CHECK(plan.memory_bytes == run.planned_memory_bytes);
  CHECK(plan.z_range.span() < before.z_range.span());
  CHECK((plan.grid.east != before.grid.east || plan.grid.north != before.grid.north));
  CHECK(plan.megapixels == doctest::Approx(2e-6 * 256 * 256).epsilon(0.2));
}

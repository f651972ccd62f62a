// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/rng.h"
#include "satsurf/nn/hypotheses.h"
#include "satsurf/nn/weights_file.h"
#include "satsurf/reconstruct/narrow.h"
#include "satsurf/reconstruct/reconstruct.h"
#include "satsurf/scene/crop.h"
#include "satsurf/scene/view_geometry.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>
#include <vector>

#include "tests/reconstruct/simulated.h"
#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::reconstruct;

namespace {

scene::Scene scene_of(const scene::SimulatedScene& made, const rpc::HeightRange& height_range) {
  return scene::scene_from_images(test::HeldImages(made).images(), height_range).scene;
}

scene::Scene village_scene(Index pixels, const rpc::HeightRange& height_range) {
  return scene_of(test::village(pixels, 3), height_range);
}

/// Heights of a scene that fall into two images or more, m above the ellipsoid.
rpc::HeightRange seen_by_two(const scene::SimulatedScene& made) {
  rpc::HeightRange out{made.h_max, made.h_min};
  const scene::HeightField& dsm = made.dsm;
  for (Index row = 0; row < dsm.z.dim(0); ++row)
    for (Index col = 0; col < dsm.z.dim(1); ++col) {
      const double z = static_cast<double>(dsm.z[row * dsm.z.dim(1) + col]);
      const rpc::Geodetic at =
          made.frame.geodetic_from_local({dsm.x0 + (static_cast<double>(col) + 0.5) * dsm.step,
                                          dsm.y0 - (static_cast<double>(row) + 0.5) * dsm.step, z});
      const auto seen = std::ranges::count_if(made.views, [&](const scene::SimulatedView& v) {
        const rpc::Pixel p = v.rpc.project(at);
        return p.x >= 0 && p.y >= 0 && p.x < static_cast<double>(v.rgb.dim(2)) &&
               p.y < static_cast<double>(v.rgb.dim(1));
      });
      if (seen >= 2) out = hull(out, {z + made.frame.h0, z + made.frame.h0});
    }
  return out;
}

ReconstructOptions without_look() {
  ReconstructOptions options;
  options.surface = Surface::plain, options.look = false;
  return options;
}

/// Noise instead of that share of a view's columns, from the left.
void spoil_left(scene::View& view, double share) {
  Rng rng(5);
  const Index W = view.width(),
              columns = static_cast<Index>(share * static_cast<double>(view.width()));
  for (Index row = 0; row < 3 * view.height(); ++row)
    for (Index col = 0; col < columns; ++col)
      view.rgb[row * W + col] = static_cast<float>(rng.uniform());
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
    CHECK(found.span() < truth.span() + 20);  // 15 m of margins
    // what was seen to agree above is not taken away, what was below is
    scene.z_agreed = rpc::HeightRange{scene.z_range.low + 1, scene.z_range.middle()};
    const rpc::HeightRange kept = narrowed_range(model, scene);
    CHECK(kept.low >= scene.z_range.low + 0.9 * below);
    CHECK(kept.high >= scene.z_agreed->high);
    CHECK(kept.high < scene.z_range.high - 0.2 * scene.z_range.span());
  }
}

TEST_CASE("towers stay in a range that is narrowed") {
  const nn::Model model = nn::load_model(SATSURF_TEST_WEIGHTS);
  for (const std::int64_t number : {20, 25, 32}) {
    CAPTURE(number);
    const scene::SimulatedScene made = test::place(scene::SceneKind::city, 320, 3, number);
    const rpc::HeightRange truth = seen_by_two(made);
    CHECK(truth.span() > 70);
    const scene::Scene scene = scene_of(made, {truth.low - 5, truth.high + 65});
    const rpc::HeightRange found = scene.frame.heights_from_z(narrowed_range(model, scene));
    CHECK(found.low <= truth.low);
    CHECK(found.high >= truth.high);
    // nor does the first stage rule them out where nothing looked before
    const Reconstruction run = reconstruct::reconstruct(model, scene, without_look());
    const rpc::HeightRange left = run.frame.heights_from_z(run.z_range);
    CHECK(left.low <= truth.low);
    CHECK(left.high >= truth.high);
  }
}

TEST_CASE("the first stage leaves of a range what the surface needs") {
  const scene::SimulatedScene made = test::village(320, 3);
  const nn::Model model = nn::load_model(SATSURF_TEST_WEIGHTS);
  scene::Scene scene = scene_of(made, {made.h_min - 45, made.h_max + 45});
  const auto left_of = [&] {
    const Reconstruction run = reconstruct::reconstruct(model, scene, without_look());
    return run.frame.heights_from_z(run.z_range);
  };
  const rpc::HeightRange left = left_of();
  CHECK(left.low <= made.h_min);
  CHECK(left.high >= made.h_max);
  CHECK(left.span() < made.h_max - made.h_min + 60);
  // what was seen to agree above is kept, what was below is not
  const rpc::HeightRange agreed{scene.z_range.low + 1, scene.z_range.high - 1};
  scene.z_agreed = agreed;
  CHECK(left_of().low == left.low);
  CHECK(left_of().high >= scene.frame.heights_from_z(agreed).high);
  // and all of it where views agree on a small part of the ground alone
  scene.z_agreed.reset();
  spoil_left(scene.views[1], 0.6);
  spoil_left(scene.views[2], 0.6);
  CHECK(left_of().span() == doctest::Approx(scene.z_range.span()));
}

TEST_CASE("heights apart from the others are looked at again") {
  // Level ground, and on a tenth of it a roof that every view puts at the same height.
  const scene::Scene scene = village_scene(320, {-20, 100});
  const nn::ModelConfig config = nn::model_preset("base8");
  const std::array<double, 3> middle =
      scene.frame.local_from_geodetic(scene.views[0].rpc.localize({160, 160}, scene.frame.h0));
  const scene::Crop crop =
      scene::make_crop(scene, {.sources = {0, 1, 2},
                               .centre = {middle[0], middle[1], scene.z_range.low + 20},
                               .size = {320, 320},
                               .z_range = scene.z_range});
  const Index stride = nn::kStrides[0], side = 320 / stride;
  const double ground = scene.z_range.low + 20;
  const auto first_with = [&](double roof, double metres) {
    Tensor heights({3, side, side});
    for (Index i = 0; i < heights.count(); ++i) {
      const nn::PosedImage& view = crop.input.sources[static_cast<std::size_t>(i / (side * side))];
      const auto x = static_cast<double>(i % side * stride),
                 y = static_cast<double>(i / side % side * stride);
      const auto at = view.local_from_pixel(x, y, roof);
      const bool on_roof =
          std::abs(at[0] - middle[0]) < metres / 2 && std::abs(at[1] - middle[1]) < metres / 2;
      heights[i] = static_cast<float>(on_roof ? roof : ground);
    }
    nn::StageHeights<float> first;
    first.height = Var(std::move(heights));
    first.choices = config.hypotheses[0];
    first.confidence = Var(Tensor({3, side, side}, 0.9f));
    first.joint_confidence = Tensor({3, side, side}, 0.9f);
    return first;
  };
  int looks = 0;
  rpc::HeightRange looked = scene.z_range;
  const auto left = [&](const nn::StageHeights<float>& first) {
    looks = 0;
    return range_left(config, scene, crop.input, first, [&] {
      ++looks;
      return looked;
    });
  };
  // nothing apart: what is left is cut without a look
  const auto flat = left(first_with(ground, 0));
  REQUIRE(flat.has_value());
  CHECK(looks == 0);
  CHECK(flat->high < ground + 30);
  // a step of 4 m is no gap
  left(first_with(ground + 4, 40));
  CHECK(looks == 0);
  // a roof at the upper end: what the look leaves counts, above and below alike
  looked = {ground - 10, ground + 20};
  CHECK(left(first_with(scene.z_range.high - 3, 40)) == looked);
  CHECK(looks == 1);
  CHECK(left(first_with(scene.z_range.low + 1, 40)) == looked);
  CHECK(looks == 1);
  // a look that finds the roof, too, changes nothing: the first stage's own cut remains
  looked = scene.z_range;
  const auto tower = left(first_with(ground + 40, 40));
  CHECK(looks == 1);
  REQUIRE(tower.has_value());
  CHECK(tower->high >= ground + 40);
  CHECK(tower->high < scene.z_range.high);
  // without one to take all goes on alike
  CHECK(range_left(config, scene, crop.input, first_with(ground + 40, 40)) == tower);
}

TEST_CASE("a range is left alone that is hardly more than the margins") {
  const nn::Model model(nn::model_preset("tiny"), 3);
  scene::Scene scene = village_scene(96, test::range_of(test::village(96, 3)));
  const double parallax =
      mean_parallax(scene::cameras_at(scene.views, scene.frame, {0, 0, scene.z_range.middle()}));
  const double margin = std::max(5.0, 2 / parallax);
  scene.z_range.high = scene.z_range.low + 5.99 * margin;
  int asked = 0;
  CHECK(narrowed_range(model, scene, [&] { ++asked; }) == scene.z_range);
  CHECK(asked == 0);
  scene.z_range.high = scene.z_range.low + 6.1 * margin;
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
  // what the look leaves is planned, and the first stage may leave less of it
  CHECK(run.z_range.low >= plan.z_range.low);
  CHECK(run.z_range.high <= plan.z_range.high);
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

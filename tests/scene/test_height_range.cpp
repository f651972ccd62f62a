// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"
#include "satsurf/core/rng.h"
#include "satsurf/scene/height_range.h"
#include "satsurf/scene/simulate/scene.h"

#include <algorithm>
#include <cmath>
#include <string>

#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::scene;

namespace {

constexpr Index kSide = 192;  // px of an image

SimulateConfig small_scene() {
  SimulateConfig c;
  c.pixels = kSide;
  c.gsd = 0.5;
  c.panchromatic = 0;
  return c;
}

Scene images_of(const SimulatedScene& made) {
  Scene scene;
  scene.frame = made.frame;
  for (const SimulatedView& v : made.views)
    scene.views.push_back({"v", v.rgb, Tensor({kSide, kSide}, 1.f), v.rpc, 0, 0, "", "v.tif"});
  return scene;
}

constexpr float kGround = 30, kTower = 120;  // m

/// A tower of 20 by 20 m amid houses of 3 to 12 m; 160 m a side.
GivenSurface tower_amid_houses() {
  constexpr Index N = 320;
  GivenSurface s{.z = Tensor({N, N}, kGround),
                 .classes = Tensor({N, N}, 2.f),
                 .grid = {.epsg = 32633, .x0 = 500000, .y0 = 5400160, .step = 0.5},
                 .zone = {.number = 33, .north = true}};
  const auto build = [&](Index row, Index column, Index side, float height) {
    for (Index i = row; i < row + side; ++i)
      for (Index j = column; j < column + side; ++j) {
        s.z[i * N + j] = height;
        s.classes[i * N + j] = 6;
      }
  };
  Rng rng(5);
  for (Index row = 4; row + 24 < N; row += 32)
    for (Index column = 4; column + 24 < N; column += 32)
      build(row, column, 18, kGround + static_cast<float>(rng.uniform(3, 12)));
  build(140, 140, 40, kTower);
  return s;
}

/// What may stand out of what is found: 15 m, and a quarter of the span, below it 15 m at most.
void check_margins(const FoundHeights& heights) {
  const auto& [agreed, found] = heights;
  const double relief = 0.25 * agreed.span();
  CHECK(found.low == doctest::Approx(agreed.low - 15 - std::min(relief, 15.0)));
  CHECK(found.high == doctest::Approx(agreed.high + 15 + relief));
}

}  // namespace

TEST_CASE("the height range of a scene is found by comparing its images") {
  SimulateConfig config = small_scene();
  config.views = 4;
  config.kinds = {scene::SceneKind::rural};
  const SimulatedScene made = simulate_scene(config, 11, 0);
  Scene scene = images_of(made);
  const double low = made.h_min - made.frame.h0, high = made.h_max - made.frame.h0;
  const FoundHeights heights = find_height_range(scene, {low - 300, high + 300});
  const auto& [agreed, found] = heights;
  CHECK(agreed.low > low - 5);
  CHECK(agreed.high < high + 5);
  CHECK(agreed.span() > 0.3 * (high - low));
  // percentiles may miss the deepest corner, the margin covers most of it
  CHECK(found.low < low + 8);
  CHECK(found.high > high - 8);
  CHECK(found.span() < high - low + 80);
  check_margins(heights);
  CHECK_THROWS_AS(find_height_range(scene, {high + 400, high + 700}), Error);
  struct Stop {};
  CHECK_THROWS_AS(find_height_range(scene, {low, high}, [] { throw Stop{}; }), Stop);
  try {
    find_height_range(scene, {low - 300, high + 300}, {}, [](double, double) { return true; });
    FAIL("expected an Error");
  } catch (const Error& e) {
    CHECK(std::string(e.what()).find(": 0 windows agree at any height from ") != std::string::npos);
    CHECK(std::string(e.what()).ends_with(" more do under --mask; give a height range"));
  }
  Scene alone = scene;
  alone.views.resize(1);
  CHECK_THROWS_WITH_AS(
      find_height_range(alone, {low, high}),
      "v.tif: no other image sees its ground, expected one or more to compare it with", Error);
  // an image of something else does not make it wider
  Scene with_another = scene;
  with_another.views.push_back(scene.views[1]);
  Tensor& other = with_another.views.back().rgb = Tensor({3, kSide, kSide});
  for (Index i = 0; i < other.count(); ++i) other[i] = static_cast<float>(i * 7919 % 1009) / 1009;
  const FoundHeights still = find_height_range(with_another, {low - 300, high + 300});
  CHECK(still.range.low < low + 8);
  CHECK(still.range.high > high - 8);
  CHECK(still.range.span() < high - low + 80);
  check_margins(still);
  for (Index i = 0; i < scene.views[1].rgb.count(); ++i)  // smooth, but not of one grey
    scene.views[1].rgb[i] = 0.3f + 0.1f * static_cast<float>(i % kSide) / kSide;
  CHECK_THROWS_WITH_AS(find_height_range(scene, {low, high}),
                       "v.tif: 0 windows with texture, expected 100 or more to compare with the "
                       "other images",
                       Error);
}

TEST_CASE("a single tower is found, also where the first image does not show it") {
  SimulateConfig config = small_scene();
  config.views = 3;
  const SimulatedScene made = simulate_on_surface(tower_amid_houses(), config, 8, 0);
  Scene scene = images_of(made);
  const double ground = static_cast<double>(kGround) - made.frame.h0,
               tower = static_cast<double>(kTower) - made.frame.h0;
  const rpc::HeightRange searched{ground - 300, ground + 450};
  const auto highest = [&] {
    const FoundHeights heights = find_height_range(scene, searched);
    check_margins(heights);
    return heights.agreed.high;
  };
  CHECK(std::abs(highest() - tower) < 8);
  // as if a cloud lay on it
  const Tensor& z = made.views[0].height;
  REQUIRE(z.count() == kSide * kSide);
  for (Index i = 0; i < z.count(); ++i)
    if (static_cast<double>(z[i]) > ground + 15) scene.views[0].valid[i] = 0;
  CHECK(std::abs(highest() - tower) < 8);
  scene.views.pop_back();
  CHECK(highest() < ground + 30);
}

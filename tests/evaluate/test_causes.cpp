// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/scores_json.h"
#include "satsurf/core/rng.h"
#include "satsurf/evaluate/causes.h"
#include "satsurf/evaluate/table.h"
#include "satsurf/nn/hypotheses.h"
#include "satsurf/scene/classes.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <string>
#include <vector>

#include "tests/affine_scene.h"
#include "tests/temp_folder.h"
#include <doctest/doctest.h>
#include <nlohmann/json.hpp>

using namespace satsurf;
using namespace satsurf::evaluate;
using satsurf::test::AffineCamera;
using satsurf::test::error_of;

namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr Index kSide = 40, kFirst = 16, kLast = 24;  // of the plane, and of the box on it: cells

/// A box of 8 x 8 cells on a plane of 40 x 40, centred at the origin.
scene::HeightField box_on_plane(float box, double step = 1) {
  const double half = 0.5 * step * static_cast<double>(kSide);
  scene::HeightField field{Tensor({kSide, kSide}), -half, half, step};
  for (Index i = kFirst; i < kLast; ++i)
    for (Index j = kFirst; j < kLast; ++j) field.z[i * kSide + j] = box;
  return field;
}
/// Ground, and a building where the box is.
Tensor box_classes() {
  Tensor classes = box_on_plane(scene::kBuildingClass - scene::kGroundClass).z;
  for (float& c : classes.values()) c += scene::kGroundClass;
  return classes;
}

/// A camera whose rays run `west` m to the west for each metre they rise, 0.5 m a pixel.
LitView looking(double west, std::optional<std::array<double, 2>> to_sun = std::nullopt) {
  constexpr Index kPixels = 200;
  const AffineCamera camera{
      .gsd = 0.5, .slope_x = 2 * west, .centre = static_cast<double>(kPixels - 1) / 2};
  return {{Tensor({3, kPixels, kPixels}), Tensor({kPixels, kPixels}, 1.f),
           camera.local_from_pixel(), camera.pixel_from_local()},
          to_sun};
}

/// A view with the sun 45 degrees high.
scene::View lit_from(double azimuth) {
  scene::View view;
  view.sun_elevation_deg = 45, view.sun_azimuth_deg = azimuth;
  return view;
}

/// On a central meridian, where the grid's north is true.
const rpc::LocalFrame kFrame{{31, true}, 500000, 5500000, 0};

Index count(const CauseFlags& flags, Cause cause) {
  const Tensor cells = flags.of(cause);
  return static_cast<Index>(std::count(cells.values().begin(), cells.values().end(), 1.f));
}
/// Whether exactly the cells of a rectangle, or of two, have the cause.
bool only(const CauseFlags& flags, Cause cause, const std::vector<std::array<Index, 4>>& expected) {
  const Tensor cells = flags.of(cause);
  for (Index k = 0; k < cells.count(); ++k) {
    const Index i = k / kSide, j = k % kSide;
    const bool inside = std::ranges::any_of(
        expected, [&](const auto& r) { return i >= r[0] && i < r[1] && j >= r[2] && j < r[3]; });
    if ((cells[k] > 0) != inside) return false;
  }
  return true;
}
bool known(const CauseFlags& flags, Cause cause) {
  return flags.known[static_cast<std::size_t>(cause)];
}
const CauseScore& of(const CauseScores& scores, Cause cause) {
  return scores[static_cast<std::size_t>(cause)];
}

}  // namespace

TEST_CASE("causes: what a box hides") {
  const scene::HeightField truth = box_on_plane(10);
  // From the west the wall of 10 m hides 5 m of ground to its east, from the east 3 m to its west.
  const LitView west = looking(0.5), east = looking(-0.3), above = looking(0);
  const std::array<Index, 4> behind{kFirst, kLast, kLast, kLast + 5},
      before{kFirst, kLast, kFirst - 3, kFirst};
  const CauseFlags two = find_causes(truth, {}, {west, east});
  CHECK(only(two, Cause::hidden, {behind, before}));
  CHECK(only(two, Cause::seen_by_one, {behind, before}));
  const CauseFlags three = find_causes(truth, {}, {west, east, above});
  CHECK(only(three, Cause::hidden, {behind, before}));
  CHECK(count(three, Cause::seen_by_one) == 0);
  const CauseFlags twice = find_causes(truth, {}, {west, east, west});
  CHECK(only(twice, Cause::hidden, {behind, before}));
  CHECK(only(twice, Cause::seen_by_one, {behind}));
  CHECK(count(find_causes(truth, {}, {above, above}), Cause::hidden) == 0);

  LitView elsewhere = east;  // sees no ground that the truth has
  elsewhere.image.pixel_from_local.coeff[0][0] += 1000;
  CHECK(only(find_causes(truth, {}, {west, above, elsewhere}), Cause::hidden, {behind}));

  scene::HeightField unknown = truth;
  unknown.z = truth.z.clone();
  for (float& z : unknown.z.values())
    if (z > 0) z = kNan;
  CHECK(count(find_causes(unknown, {}, {west, east}), Cause::hidden) == 0);
}

TEST_CASE("causes: rays over a rough surface, against small steps along them") {
  scene::HeightField truth{Tensor({48, 48}), -24, 24, 1};
  Rng rng(5);
  for (float& z : truth.z.values())
    z = static_cast<float>(rng.uniform(0, 1) + (rng.chance(0.1) ? rng.uniform(2, 9) : 0));
  const auto hidden_along = [&](Index row, Index col, double east, double north) {
    const auto from = static_cast<double>(truth.z[row * 48 + col]);
    for (double up = 0; from + up < 10; up += 0.002) {
      const auto i = static_cast<Index>(std::floor(static_cast<double>(row) + 0.5 - north * up)),
                 j = static_cast<Index>(std::floor(static_cast<double>(col) + 0.5 + east * up));
      if (i < 0 || i >= 48 || j < 0 || j >= 48) return false;
      if (static_cast<double>(truth.z[i * 48 + j]) > from + up) return true;
    }
    return false;
  };
  Index missed = 0, grazed = 0, hidden = 0, shaded = 0;
  const auto compare = [&](float flag, bool met) {
    missed += flag == 0 && met;
    grazed += flag > 0 && !met;  // steps may pass over an edge that a ray grazes
  };
  for (const auto& [west, sun_east, sun_north] :
       {std::array{0.5, 0.4, 0.3}, {-0.7, 1.1, -1.3}, {1.2, -0.2, 0.9}}) {
    const CauseFlags flags =
        find_causes(truth, {}, {looking(west, std::array{sun_east, sun_north})});
    const Tensor hid = flags.of(Cause::hidden), dark = flags.of(Cause::shadow);
    for (Index k = 0; k < hid.count(); ++k) {
      compare(hid[k], hidden_along(k / 48, k % 48, -west, 0));
      compare(dark[k], hidden_along(k / 48, k % 48, sun_east, sun_north));
      hidden += hid[k] > 0, shaded += dark[k] > 0;
    }
  }
  CHECK(hidden > 500);
  CHECK(shaded > 500);
  CHECK(missed == 0);
  CHECK(grazed < 50);  // of 13824 rays
}

TEST_CASE("causes: shadow") {
  const scene::HeightField truth = box_on_plane(10);
  const auto south = slope_to_sun(lit_from(180), kFrame),
             west = slope_to_sun(lit_from(270), kFrame);
  REQUIRE(south);
  CHECK((*south)[0] == doctest::Approx(0));
  CHECK((*south)[1] == doctest::Approx(-1));
  CHECK_FALSE(slope_to_sun(scene::View(), kFrame));

  // at 45 degrees a shadow is as long as the wall is high
  const std::array<Index, 4> north{kFirst - 10, kFirst, kFirst, kLast},
      east{kFirst, kLast, kLast, kLast + 10};
  const CauseFlags one = find_causes(truth, {}, {looking(0, south), looking(0)});
  CHECK(known(one, Cause::shadow));
  CHECK(only(one, Cause::shadow, {north}));
  CHECK(only(find_causes(truth, {}, {looking(0, south), looking(0, west)}), Cause::shadow,
             {north, east}));
  CHECK_FALSE(known(find_causes(truth, {}, {looking(0), looking(0)}), Cause::shadow));

  LitView elsewhere = looking(0, west);
  elsewhere.image.pixel_from_local.coeff[0][0] += 1000;
  CHECK(only(find_causes(truth, {}, {looking(0, south), elsewhere}), Cause::shadow, {north}));
}

TEST_CASE("causes: the sun's azimuth is against true north") {
  const rpc::LocalFrame frame{{31, true}, 700000, 5500000, 0};
  const rpc::Geodetic here = frame.geodetic_from_local({0, 0, 0});
  CHECK(rpc::grid_convergence_deg(frame, here) ==
        doctest::Approx(std::atan(std::tan((here.lon - 3) * std::numbers::pi / 180) *
                                  std::sin(here.lat * std::numbers::pi / 180)) *
                        180 / std::numbers::pi)
            .epsilon(1e-3));
  rpc::Geodetic southwards = here;
  southwards.lat -= 1e-4;
  const auto p = frame.local_from_geodetic(southwards);
  const auto sun = slope_to_sun(lit_from(180), frame);
  REQUIRE(sun);
  CHECK((*sun)[0] == doctest::Approx(p[0] / std::hypot(p[0], p[1])).epsilon(1e-4));
  CHECK((*sun)[1] == doctest::Approx(p[1] / std::hypot(p[0], p[1])).epsilon(1e-4));
  CHECK(std::abs((*sun)[0]) > 0.03);
}

TEST_CASE("causes: rim, roof and ground") {
  const auto south = slope_to_sun(lit_from(180), kFrame);
  const scene::HeightField truth = box_on_plane(10);
  const CauseFlags flags = find_causes(truth, box_classes(), {looking(0.5, south), looking(-0.3)});
  for (const bool is : flags.known) CHECK(is);

  // Two cells within the box, 8 x 8 less 4 x 4, and two outside, 12 x 12 less 8 x 8 and its corners.
  const Tensor rim = flags.of(Cause::rim);
  CHECK(count(flags, Cause::rim) == 48 + 76);
  for (Index j = 0; j < kSide; ++j)
    CHECK((rim[20 * kSide + j] > 0) ==
          ((j >= 14 && j < 18) || (j >= 22 && j < 26)));  // a row through the box
  CHECK(rim[14 * kSide + 14] == 0);
  CHECK(rim[14 * kSide + 15] == 1);
  CHECK(count(find_causes(box_on_plane(2), {}, {}), Cause::rim) == 0);
  CHECK(count(find_causes(box_on_plane(2.01f), {}, {}), Cause::rim) == 48 + 76);

  CHECK(only(flags, Cause::roof_small, {{kFirst + 2, kLast - 2, kFirst + 2, kLast - 2}}));
  // ground that is hidden (64), in shadow (80), at the rim (76), or of these rim and another (48)
  CHECK(count(flags, Cause::open_ground) == 1600 - 64 - (64 + 80 + 76 - 48));
  CHECK(count(flags, Cause::tree) == 0);
  CHECK(count(flags, Cause::other) == 0);

  // cells that do not count have none, and still are in the way of those that do
  Tensor south_east({kSide, kSide});
  for (Index i = 20; i < kSide; ++i)
    for (Index j = 20; j < kSide; ++j) south_east[i * kSide + j] = 1;
  const CauseFlags part =
      find_causes(truth, box_classes(), {looking(0.5, south), looking(-0.3)}, south_east);
  for (std::size_t k = 0; k < part.cells.size(); ++k)
    CHECK(part.cells[k] == (south_east[static_cast<Index>(k)] > 0 ? flags.cells[k] : 0));
  CHECK(count(part, Cause::hidden) == 4 * 5);
}

TEST_CASE("causes: roofs by the size of the building") {
  const auto sizes = [](double step) {
    const CauseFlags flags = find_causes(box_on_plane(10, step), box_classes(), {});
    return std::array{count(flags, Cause::roof_small), count(flags, Cause::roof_medium),
                      count(flags, Cause::roof_large)};
  };
  CHECK(sizes(2.4) == std::array<Index, 3>{16, 0, 0});  // 369 m^2
  CHECK(sizes(2.5) == std::array<Index, 3>{0, 16, 0});  // 400 m^2
  CHECK(sizes(5.5) == std::array<Index, 3>{0, 16, 0});  // 1936 m^2
  CHECK(sizes(5.6) == std::array<Index, 3>{0, 0, 16});  // 2007 m^2

  // a second box touches the first at a corner: two buildings of 256 m^2, not one; along an edge:
  // one of 16 x 8 cells
  Tensor classes = box_classes();
  const auto second_box = [&](Index row) {
    for (Index i = row; i < row + 8; ++i)
      for (Index j = kLast; j < kLast + 8; ++j) classes[i * kSide + j] = scene::kBuildingClass;
  };
  second_box(kLast);
  const scene::HeightField truth = box_on_plane(10, 2);
  const CauseFlags apart = find_causes(truth, classes, {});
  CHECK(count(apart, Cause::roof_small) == 32);
  classes = box_classes();
  second_box(kFirst);
  const CauseFlags joined = find_causes(truth, classes, {});
  CHECK(count(joined, Cause::roof_small) == 0);
  CHECK(count(joined, Cause::roof_medium) == 12 * 4);
}

TEST_CASE("causes: without classes nothing is said of them") {
  const scene::HeightField truth = box_on_plane(10);
  const CauseFlags flags = find_causes(truth, {}, {looking(0.5), looking(-0.3)});
  for (const Cause cause : {Cause::roof_small, Cause::roof_medium, Cause::roof_large, Cause::tree,
                            Cause::open_ground, Cause::water, Cause::shadow})
    CHECK_FALSE(known(flags, cause));
  SceneScores scene;
  scene.name = "S";
  scene.causes = score_causes(truth.z, truth.z, Tensor(truth.z.shape(), 1.f), flags);
  for (const double number :
       {of(scene.causes, Cause::tree).cells, of(scene.causes, Cause::open_ground).share,
        of(scene.causes, Cause::roof_large).error_share})
    CHECK(std::isnan(number));
  const auto j = app::scores_json(std::vector{scene});
  std::vector<std::string> rows;
  for (const auto& [name, row] : j["scenes"][0]["causes"].items()) rows.push_back(name);
  CHECK(rows == std::vector<std::string>{"hidden", "seen_by_one", "rim", "other"});
  CHECK(j["mean"]["cause_tree_cells"].is_null());
  CHECK(j["mean"]["cause_hidden_cells"] == 64);
  CHECK(j["mean"]["cause_other_cells"] == 1600 - 64 - (48 + 76) + 32);  // 32: hidden and rim

  CHECK(error_of<ShapeError>([&] {
          find_causes(truth, Tensor({3, 4}), {});
        }).starts_with("find_causes: classes has shape [3,4], expected [H W] with "));
  CHECK(error_of<ShapeError>([&] {
          score_causes(Tensor({3, 4}), Tensor({3, 4}), Tensor({3, 4}), flags);
        }) == "score_causes: flags are of a grid [40,40], expected the truth's [3,4]");
}

TEST_CASE("causes: their scores") {
  // a flat place without steps, views and shadow: every cell has one cause
  const scene::HeightField truth{Tensor({2, 6}), 0, 0, 1};
  const Tensor classes = Tensor::from({2, 6}, {2, 2, 2, 5, 5, 9, 2, 65, 17, 5, 5, 9});
  const CauseFlags flags = find_causes(truth, classes, {});
  const Tensor surface = Tensor::from({2, 6}, {1, -3, 2, 4, 0, 1, 7, 0, -2, 2.5f, 1, 8}),
               mask = Tensor::from({2, 6}, {1, 1, 1, 1, 1, 1, 0, 1, 1, 1, 1, 0});
  const CauseScores scores = score_causes(surface, truth.z, mask, flags);
  const CauseScore &ground = of(scores, Cause::open_ground), &tree = of(scores, Cause::tree),
                   &water = of(scores, Cause::water), &other = of(scores, Cause::other);
  CHECK(ground.cells == 3);
  CHECK(ground.share == doctest::Approx(0.3));
  CHECK(ground.mae == doctest::Approx(2));
  CHECK(ground.median == doctest::Approx(1));
  CHECK(ground.pag2_5 == doctest::Approx(2.0 / 3));
  CHECK(ground.error_share == doctest::Approx(6 / 16.5));
  CHECK(tree.cells == 4);
  CHECK(tree.pag2_5 == doctest::Approx(0.5));  // an error of 2.5 m is not below it
  CHECK(tree.error_share == doctest::Approx(7.5 / 16.5));
  CHECK(water.cells == 1);
  CHECK(other.cells == 2);
  CHECK(ground.share + tree.share + water.share + other.share == doctest::Approx(1));
  CHECK(ground.error_share + tree.error_share + water.error_share + other.error_share ==
        doctest::Approx(1));
  // nobody there: no error, and none of the error
  const CauseScore& rim = of(scores, Cause::rim);
  CHECK(rim.cells == 0);
  CHECK(rim.error_share == 0);
  CHECK(std::isnan(rim.mae));

  // nothing was reconstructed: every cell is a failure
  const CauseScores none = score_causes(Tensor({2, 6}, kNan), truth.z, mask, flags);
  CHECK(of(none, Cause::tree).cells == 4);
  CHECK(of(none, Cause::tree).pag2_5 == 0);
  CHECK(std::isnan(of(none, Cause::tree).mae));
  CHECK(std::isnan(of(none, Cause::tree).error_share));

  for (const TableColumn& column : table_columns()) CHECK_FALSE(column.meaning.empty());
}

TEST_CASE("score_oracle: the best point of every cell") {
  const scene::HeightField truth{Tensor::from({1, 3}, {10, 20, 30}), 0, 1, 1};
  const Tensor all({1, 3}, 1.f);
  const std::vector<float> points{0.5f, 0.5f, 13,    0.1f, 0.9f, 9,    // cell 0: best is 1 m off
                                  1.2f, 0.2f, 20.5f,                   // 0.5 m
                                  2.5f, 0.5f, 50,    2.9f, 0.1f, 33,   // 3 m
                                  3.5f, 0.5f, 30,    0.5f, 1.5f, 10};  // off the grid
  const Tensor means = Tensor::from({7, 3}, points);
  CHECK(score_oracle(means, {0, 0, 0}, truth, all).mae == doctest::Approx(1.5));
  CHECK(score_oracle(means, {0, 0, 0}, truth, Tensor::from({1, 3}, {1, 1, 0})).mae ==
        doctest::Approx(0.75));
  CHECK(score_oracle(means, {0, 0, -3}, truth, all).mae == doctest::Approx((0 + 2.5 + 0) / 3));
  // 1 m west of the grid's own: each cell is told by what lay in the next, the last by 30 itself
  CHECK(score_oracle(means, {-1, 0, 0}, truth, all).mae == doctest::Approx((10.5 + 13 + 0) / 3));
  // the middle cell is filled: 9 and 33 count alike there
  const Tensor fewer = Tensor::from({4, 3}, {0.5f, 0.5f, 13, 0.1f, 0.9f, 9,  //
                                             2.5f, 0.5f, 50, 2.9f, 0.1f, 33});
  CHECK(score_oracle(fewer, {0, 0, 0}, truth, all).mae == doctest::Approx((1 + 1 + 3) / 3.0));
  CHECK(std::isnan(score_oracle(fewer, {100, 0, 0}, truth, all).mae));
  CHECK(score_oracle(fewer, {100, 0, 0}, truth, all).share == 0);
  CHECK(score_oracle(means, {0, 0, 0}, truth, all).share == 1);
  CHECK(score_oracle(fewer, {0, 0, 0}, truth, all).share == doctest::Approx(2.0 / 3));
}

TEST_CASE("lost_by_stage: true heights outside the next window") {
  std::array<nn::StageOutput<float>, 3> stages;
  stages[0].hypotheses = Tensor({1, 2, 1, 1});
  // 4 hypotheses 1 m apart cover from half a metre below the first to half a metre above the last
  stages[1].interval = 1;
  stages[1].hypotheses =
      Tensor::from({1, 4, 1, 4}, {0, 10, 0, 0, 1, 11, 1, 1, 2, 12, 2, 2, 3, 13, 3, 3});
  stages[2].interval = 0.5;
  stages[2].hypotheses = Tensor::from({1, 2, 1, 2}, {0, 0, 0.5f, 0.5f});
  const Tensor coarse({1, 1}), middle = Tensor::from({1, 4}, {3.4f, 9.4f, kNan, 3.6f}),
                               fine = Tensor::from({1, 2}, {-0.2f, 0.7f});
  CHECK(lost_by_stage(stages, {{coarse}, {middle}, {fine}}) == std::array<double, 2>{2.0 / 3, 0});
  const Tensor missed = Tensor::from({1, 2}, {-0.3f, 0.8f});
  CHECK(lost_by_stage(stages, {{coarse}, {middle}, {missed}})[1] == 1);
  CHECK(std::isnan(lost_by_stage(stages, {{coarse}, {Tensor({1, 4}, kNan)}, {fine}})[0]));
  CHECK(error_of<ShapeError>([&] {
          lost_by_stage(stages, {{coarse}, {coarse}, {fine}});
        }) == "lost_by_stage: truth has shape [1,1], expected [1,4] of the stage");

  stages[1].hypotheses = {};  // the first is followed by the last, and the second searches nothing
  const auto without = lost_by_stage(stages, {{coarse}, {middle}, {missed}});
  CHECK(without[0] == 1);
  CHECK(std::isnan(without[1]));
  stages[2].hypotheses = {};
  CHECK(std::isnan(lost_by_stage(stages, {{coarse}, {middle}, {fine}})[0]));
}

TEST_CASE("lost_by_stage: the window is as wide as the stage before is told") {
  const nn::NetworkInput scene =
      test::affine_scene(32, {{0.4, 0}, {-0.4, 0.1}}, -40, 40, [](double, double) { return 0.0; });
  const nn::ModelConfig config = nn::model_preset("tiny");
  const auto grids = nn::stage_grids(config, scene);
  std::array<nn::StageOutput<float>, 3> stages;
  std::vector<std::vector<Tensor>> truth(3);
  constexpr float kCentre = 3;
  for (std::size_t s = 0; s < 3; ++s) {
    const nn::StageGrid& grid = grids[s];
    stages[s].interval = grid.interval;
    stages[s].hypotheses = nn::stage_hypotheses<float>(
        scene.z_range, grid, s == 0 ? nullptr : &stages[s - 1], config.centre);
    stages[s].height = Var(Tensor({grid.views, grid.height, grid.width}, kCentre));
    truth[s].assign(static_cast<std::size_t>(grid.views), Tensor({grid.height, grid.width}, kNan));
  }
  for (std::size_t s = 0; s < 2; ++s) {
    REQUIRE(grids[s].next_reach > 0);
    const auto lost_at = [&](double share_of_reach) {
      auto shifted = truth;
      shifted[s + 1][0].fill(kCentre + static_cast<float>(share_of_reach * grids[s].next_reach));
      return lost_by_stage(stages, shifted)[s];
    };
    for (const double side : {-1.0, 1.0}) {
      CHECK(lost_at(0.99 * side) == 0);
      CHECK(lost_at(1.01 * side) == 1);
    }
  }
}

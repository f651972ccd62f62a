// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/core/rng.h"
#include "satsurf/scene/pointing.h"
#include "satsurf/scene/pointing_file.h"
#include "satsurf/scene/simulate/as_scene.h"
#include "satsurf/scene/simulate/scene.h"

#include <cmath>
#include <fstream>
#include <numbers>
#include <string>
#include <vector>

#include "tests/temp_folder.h"
#include <Eigen/Dense>
#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::scene;

namespace {

struct Place {
  Scene scene;
  rpc::HeightRange heights;  // as the cameras would name them, wide
};

Place place_of(SceneKind kind, Index pixels, Index views, bool same_pass, std::uint64_t seed) {
  SimulateConfig config;
  config.pixels = pixels, config.views = views, config.gsd = 0.5, config.kinds = {kind};
  config.water = 0, config.heights = false, config.same_pass = same_pass ? 1 : 0;
  config.parallax_min = 0.2, config.parallax_max = 1.6;
  const SimulatedScene made = simulate_scene(config, seed, 0);
  return {as_scene(made, "place"), {made.h_min - 100, made.h_max + 100}};
}

/// A shift of `length` px in a random direction for every image.
std::vector<rpc::Pixel> errors_of(std::size_t images, double length, std::uint64_t seed) {
  Rng rng(seed);
  std::vector<rpc::Pixel> out;
  for (std::size_t i = 0; i < images; ++i) {
    const double angle = rng.uniform(0, 2 * std::numbers::pi);
    out.push_back({length * std::cos(angle), length * std::sin(angle)});
  }
  return out;
}

void spoil(std::vector<View>& views, const std::vector<rpc::Pixel>& errors) {
  for (std::size_t i = 0; i < views.size(); ++i)
    views[i].rpc = views[i].rpc.cropped(-errors[i].x, -errors[i].y);
}

/// What is left of the errors after the shifts once the ground that suits them best has been moved:
/// root mean square over images, px. Only this much can be known from images.
double left_over(const std::vector<View>& views, const std::vector<rpc::Pixel>& errors,
                 const std::vector<rpc::Pixel>& shifts, double height) {
  const auto n = static_cast<Eigen::Index>(views.size());
  Eigen::MatrixXd J(2 * n, 3);
  Eigen::VectorXd e(2 * n);
  const rpc::Rpc& first = views[0].rpc;
  const rpc::Geodetic at = first.localize(
      {static_cast<double>(views[0].width()) / 2, static_cast<double>(views[0].height()) / 2},
      height);
  for (Eigen::Index i = 0; i < n; ++i) {
    const auto k = static_cast<std::size_t>(i);
    const auto j = views[k].rpc.jacobian(at);
    for (Eigen::Index r = 0; r < 2; ++r) {
      const auto& row = j[static_cast<std::size_t>(r)];
      J.row(2 * i + r) << row[0] * 1e-5, row[1] * 1e-5, row[2];
    }
    e.segment<2>(2 * i) << errors[k].x + shifts[k].x, errors[k].y + shifts[k].y;
  }
  const Eigen::VectorXd rest = e - J * J.completeOrthogonalDecomposition().solve(e);
  return std::sqrt(rest.squaredNorm() / static_cast<double>(n));
}

/// Length of the mean displacement of the ground that the shifts stand for, m.
double mean_on_the_ground(const std::vector<View>& views, const std::vector<rpc::Pixel>& shifts,
                          double height) {
  const rpc::Geodetic at = views[0].rpc.localize(
      {static_cast<double>(views[0].width()) / 2, static_cast<double>(views[0].height()) / 2},
      height);
  double east = 0, north = 0;
  for (std::size_t i = 0; i < views.size(); ++i) {
    const rpc::Pixel p = views[i].rpc.project(at);
    const rpc::Geodetic q = views[i].rpc.localize({p.x + shifts[i].x, p.y + shifts[i].y}, height);
    east +=
        std::remainder(q.lon - at.lon, 360) * 111320 * std::cos(at.lat * std::numbers::pi / 180);
    north += (q.lat - at.lat) * 110574;
  }
  return std::hypot(east, north) / static_cast<double>(views.size());
}

}  // namespace

TEST_CASE("pointing is recovered from images of one pass and of several dates") {
  struct Case {
    SceneKind kind;
    Index views;
    bool same_pass;
    double most;  // px, about twice what is left over
  };
  for (const Case& c :
       {Case{SceneKind::village, 2, true, 0.1}, Case{SceneKind::city, 3, true, 0.1},
        Case{SceneKind::suburb, 2, false, 0.1}, Case{SceneKind::village, 3, false, 0.1},
        Case{SceneKind::city, 5, false, 0.2}}) {
    CAPTURE(enum_name(c.kind));
    CAPTURE(c.views);
    CAPTURE(c.same_pass);
    const Place place = place_of(c.kind, 384, c.views, c.same_pass, 40);
    for (const double length : {0.0, 1.0, 5.0, 30.0}) {
      CAPTURE(length);
      std::vector<View> views = place.scene.views;
      const auto errors = errors_of(views.size(), length, 7);
      spoil(views, errors);
      const Pointing p = measure_pointing(views, place.heights);
      CHECK(left_over(views, errors, p.shifts, place.heights.middle()) < c.most);
      if (length > 0)
        CHECK(left_over(views, errors, std::vector<rpc::Pixel>(views.size()), 0) > 0.2 * length);
      CHECK(p.applied == (p.largest_shift > 0.3));
      CHECK(p.applied == (length > 0));
      // all but lifting the ground, of two images all but the shift across the epipolar direction
      CHECK(p.observable == 2 * c.views - 3);
      CHECK(*mean_across(p.after) < 0.4);
      if (length > 0) CHECK(*mean_across(p.before) > 2 * *mean_across(p.after));
      CHECK(mean_on_the_ground(views, p.shifts, place.heights.middle()) < 0.01);
    }
  }
}

TEST_CASE("images of different dates are connected, all of them") {
  // pairs of these have 55 to 70 of a hundred matches on one line, where chance has at most 40
  const std::pair<SceneKind, std::uint64_t> places[] = {{SceneKind::suburb, 58},
                                                        {SceneKind::village, 55},
                                                        {SceneKind::industrial, 51},
                                                        {SceneKind::city, 51}};
  for (const auto& [kind, seed] : places) {
    CAPTURE(enum_name(kind));
    const Place place = place_of(kind, 256, 3, false, seed);
    const Pointing p = measure_pointing(place.scene.views, place.heights);
    for (const PairResidual& pair : p.before) CHECK(pair.ties >= kFewestTies);
    CHECK(p.undetermined == 0);
    CHECK(p.unconnected.empty());
  }
}

TEST_CASE("tie points do not depend on the number of threads") {
  const Place place = place_of(SceneKind::village, 192, 3, true, 40);
  const auto seen = [&] {
    std::vector<double> out;
    for (const TiePoint& t : find_tie_points(place.scene.views, place.heights, 50))
      for (const Sighting& s : t.sightings)
        out.insert(out.end(), {static_cast<double>(s.view), s.pixel.x, s.pixel.y});
    return out;
  };
  const auto many = seen();
  CHECK(many.size() > 500);
  set_threads(1);
  const auto one = seen();
  set_threads(0);
  CHECK(one == many);
}

TEST_CASE("adjustment of made-up tie points") {
  const Place place = place_of(SceneKind::village, 64, 4, true, 41);  // cameras nearly in one plane
  std::vector<rpc::Rpc> cameras;
  for (const View& v : place.scene.views) cameras.push_back(v.rpc);
  const std::vector<rpc::Pixel> errors{{11, -4}, {-7, 9}, {0.5, 2}, {-20, -3}};
  Rng rng(3);
  std::vector<TiePoint> points;
  const double height = place.heights.middle();
  for (int k = 0; k < 300; ++k) {
    const rpc::Geodetic at = cameras[0].localize({rng.uniform(0, 64), rng.uniform(0, 64)},
                                                 height + rng.uniform(-20, 20));
    TiePoint point;
    for (std::size_t i = 0; i < cameras.size(); ++i) {
      if (rng.chance(0.3)) continue;
      rpc::Pixel p = cameras[i].project(at);
      p = {p.x - errors[i].x + 0.1 * rng.normal(), p.y - errors[i].y + 0.1 * rng.normal()};
      if (rng.chance(0.1)) p.x += rng.uniform(-30, 30), p.y += rng.uniform(-30, 30);  // a mistake
      point.sightings.push_back({i, p});
    }
    if (point.sightings.size() > 1) points.push_back(point);
  }
  SUBCASE("shifts are found in spite of mistakes") {
    const PointingAdjustment found = adjust_pointing(cameras, points, height);
    CHECK(found.observable == 5);
    CHECK(left_over(place.scene.views, errors, found.shifts, height) < 0.03);
    const TieResiduals before = tie_residuals(cameras, std::vector<rpc::Pixel>(4), points, height),
                       after = tie_residuals(cameras, found.shifts, points, height);
    REQUIRE(before.pairs.size() == 6);
    for (std::size_t k = 0; k < 6; ++k) {
      CHECK(after.pairs[k].across < 0.25);
      CHECK(after.pairs[k].ties == before.pairs[k].ties);
    }
    CHECK(*mean_across(before.pairs) > 5);
  }
  SUBCASE("points in two images each say nothing along the plane of the cameras") {
    std::vector<TiePoint> split;
    for (const TiePoint& t : points)
      for (std::size_t i = 0; i + 1 < t.sightings.size(); ++i)
        split.push_back({{t.sightings[i], t.sightings[i + 1]}});
    CHECK(left_over(place.scene.views, errors, adjust_pointing(cameras, split, height).shifts,
                    height) > 1);
  }
  SUBCASE("of two images the shift along the epipolar direction stays zero") {
    const std::vector<rpc::Rpc> two{cameras[0], cameras[1]};
    std::vector<TiePoint> pairs;
    for (const TiePoint& t : points)
      if (t.sightings.size() > 1 && t.sightings[1].view == 1)
        pairs.push_back({{t.sightings[0], t.sightings[1]}});
    const PointingAdjustment found = adjust_pointing(two, pairs, height);
    CHECK(found.observable == 1);
    const auto j0 = two[0].jacobian(two[0].localize({32, 32}, height));
    const auto slope = two[0].ray_slope(two[0].localize({32, 32}, height));
    const auto j1 = two[1].jacobian(two[0].localize({32, 32}, height));
    const double dx = j1[0][0] * slope[0] + j1[0][1] * slope[1] + j1[0][2],
                 dy = j1[1][0] * slope[0] + j1[1][1] * slope[1] + j1[1][2];
    const rpc::Pixel& b = found.shifts[1];
    CHECK(mean_on_the_ground({place.scene.views[0], place.scene.views[1]}, found.shifts, height) <
          1e-4);
    CHECK(std::abs(b.x * dx + b.y * dy) / std::hypot(dx, dy) < 0.05 * std::hypot(b.x, b.y));
    CHECK(std::hypot(b.x, b.y) > 1);
    CHECK(j0[0][2] != 0);
  }
  SUBCASE("whichever way an image is turned") {
    const PointingAdjustment straight = adjust_pointing(cameras, points, height);
    for (const int quarters : {1, 2, 3}) {
      CAPTURE(quarters);
      std::vector<rpc::Rpc> turned = cameras;
      turned[2] = turned[2].turned(quarters, 64, 64);
      std::vector<TiePoint> seen = points;
      for (TiePoint& t : seen)
        for (Sighting& s : t.sightings)
          if (s.view == 2)
            for (int k = 0; k < quarters; ++k) s.pixel = {63 - s.pixel.y, s.pixel.x};
      const PointingAdjustment found = adjust_pointing(turned, seen, height);
      CHECK(found.observable == straight.observable);
      for (std::size_t i = 0; i < cameras.size(); ++i) {
        rpc::Pixel expected = straight.shifts[i];
        if (i == 2)
          for (int k = 0; k < quarters; ++k) expected = {-expected.y, expected.x};
        CHECK(found.shifts[i].x == doctest::Approx(expected.x).epsilon(1e-4));
        CHECK(found.shifts[i].y == doctest::Approx(expected.y).epsilon(1e-4));
      }
    }
  }
  SUBCASE("across the antimeridian as anywhere else") {
    const double east = 180 - cameras[0].localize({32, 32}, height).lon;  // through the images
    std::vector<rpc::Rpc> there = cameras;
    std::vector<View> views = place.scene.views;
    for (std::size_t i = 0; i < there.size(); ++i) {
      there[i].lon_off = std::remainder(there[i].lon_off + east, 360);
      views[i].rpc = there[i];
    }
    REQUIRE(there[0].localize({4, 32}, height).lon * there[0].localize({60, 32}, height).lon < 0);
    const PointingAdjustment here = adjust_pointing(cameras, points, height),
                             found = adjust_pointing(there, points, height);
    CHECK(found.observable == here.observable);
    for (std::size_t i = 0; i < cameras.size(); ++i) {
      CHECK(found.shifts[i].x == doctest::Approx(here.shifts[i].x).epsilon(1e-4));
      CHECK(found.shifts[i].y == doctest::Approx(here.shifts[i].y).epsilon(1e-4));
    }
    CHECK(mean_on_the_ground(views, found.shifts, height) < 0.01);
  }
  SUBCASE("without points") {
    CHECK_THROWS_WITH_AS(adjust_pointing(cameras, {}, height),
                         "adjust_pointing: 0 points in 4 images, expected some in two or more",
                         Error);
  }
}

TEST_CASE("errors that change within images are found where shifts may") {
  // The cameras are those of a strip, of which the image is a small part.
  const Place place = place_of(SceneKind::village, 64, 4, true, 41);
  std::vector<rpc::Rpc> cameras, off;
  for (const View& v : place.scene.views) cameras.push_back(v.rpc);
  const double height = place.heights.middle();
  bool sloped = false;
  SUBCASE("they do") { sloped = true; }
  SUBCASE("they do not") {}
  Rng rng(5);
  const auto errors = errors_of(4, 5, 9);
  for (std::size_t i = 0; i < 4; ++i) {
    rpc::ShiftSlope slope{{32, 32}, {}};
    for (auto& row : slope.per_pixel)
      for (double& px : row) px = sloped ? rng.uniform(-1e-3, 1e-3) : 0;
    off.push_back(cameras[i].corrected({-errors[i].x, -errors[i].y}, slope));
  }
  std::vector<TiePoint> points;
  for (int k = 0; k < 800; ++k) {
    const rpc::Geodetic at = cameras[0].localize(
        {rng.uniform(-4000, 4000), rng.uniform(-4000, 4000)}, height + rng.uniform(-20, 20));
    TiePoint point;
    for (std::size_t i = 0; i < cameras.size(); ++i) {
      rpc::Pixel p = cameras[i].project(at);
      p = {p.x + 0.2 * rng.normal(), p.y + 0.2 * rng.normal()};
      if (rng.chance(0.05)) p.x += rng.uniform(-30, 30), p.y += rng.uniform(-30, 30);
      point.sightings.push_back({i, p});
    }
    points.push_back(point);
  }
  const PointingAdjustment shifted = adjust_pointing(off, points, height),
                           found = adjust_pointing(off, points, height, true);
  CHECK(shifted.slopes.empty());
  REQUIRE(found.slopes.size() == 4);
  CHECK(found.observable > shifted.observable);
  std::vector<rpc::Rpc> by_shifts, by_slopes;
  for (std::size_t i = 0; i < 4; ++i) {
    by_shifts.push_back(off[i].corrected(shifted.shifts[i]));
    by_slopes.push_back(off[i].corrected(found.shifts[i], found.slopes[i]));
  }
  const auto across = [&](const std::vector<rpc::Rpc>& of) {
    return *mean_across(tie_residuals(of, std::vector<rpc::Pixel>(4), points, height).pairs);
  };
  const double truth = across(cameras);
  CHECK(across(off) > 2 * truth);
  CHECK(across(by_slopes) < 1.05 * truth);
  if (sloped) {
    CHECK(across(by_shifts) > 3 * truth);
    return;
  }
  // Where nothing changes within images nothing is made to.
  CHECK(across(by_shifts) < 1.05 * truth);
  for (const rpc::ShiftSlope& slope : found.slopes)
    for (const auto& row : slope.per_pixel)
      for (const double px : row) CHECK(std::abs(4000 * px) < 0.15);
}

TEST_CASE("images that share too little are not corrected, the others are") {
  Place place = place_of(SceneKind::village, 192, 3, true, 40);
  std::vector<View>& views = place.scene.views;
  spoil(views, {{3, 2}, {0, 0}, {-3, -2}});
  SUBCASE("another place's picture") {
    views[1].rgb = place_of(SceneKind::city, 192, 3, true, 77).scene.views[1].rgb;
    const Pointing p = measure_pointing(views, place.heights);
    CHECK(p.applied);
    CHECK(p.before[1].ties > 100);  // of the other two
    CHECK(p.after[1].across < 0.2 * p.before[1].across);
    CHECK(p.unconnected == std::vector<std::size_t>{1});
    CHECK(p.shifts[1].x == 0);
    CHECK(p.shifts[1].y == 0);
    CHECK(mean_on_the_ground({views[0], views[2]}, {p.shifts[0], p.shifts[2]},
                             place.heights.middle()) < 0.01);
    CHECK(p.verdict.starts_with("estimated from the images; place_002 shares "));
    CHECK(p.verdict.ends_with(
        " tie points with another image, expected 20 or more: its camera stays as it is"));
  }
  SUBCASE("a camera that looks elsewhere") {
    views[2].rpc.lon_off += 1;
    const Pointing p = measure_pointing(views, place.heights);
    CHECK(p.before[0].ties >= 20);
    CHECK(p.before[1].ties == 0);
    CHECK(p.applied);
    CHECK(p.verdict.find("; place_003 shares 0 tie points") != std::string::npos);
  }
  SUBCASE("three pictures of three places") {
    views[0].rgb = place_of(SceneKind::city, 192, 3, true, 77).scene.views[1].rgb;
    views[1].rgb = place_of(SceneKind::industrial, 192, 3, true, 78).scene.views[1].rgb;
    const Pointing p = measure_pointing(views, place.heights);
    CHECK_FALSE(p.applied);
    CHECK(p.after.empty());
    CHECK(p.largest_shift == 0);
    CHECK(p.verdict.starts_with("not estimated: place_002 shares "));
    CHECK(p.verdict.ends_with(" tie points with another image, expected 20 or more"));
  }
}

TEST_CASE("pointing that changes within images") {
  Place place = place_of(SceneKind::city, 384, 3, true, 40);
  std::vector<View>& views = place.scene.views;
  // 1 px from the middle to a side
  views[0].rpc = views[0].rpc.corrected({1, 3}, {{192, 192}, {{{5e-3, -2e-3}, {2e-3, -5e-3}}}});
  const Pointing shifted = measure_pointing(views, place.heights),
                 found = measure_pointing(views, place.heights, {}, true);
  INFO(found.verdict);
  REQUIRE(found.applied);
  CHECK(shifted.slopes.empty());
  CHECK(*mean_across(found.after) < 0.4);
  CHECK(*mean_across(shifted.after) > 1.5 * *mean_across(found.after));
  double largest = 0;
  for (const rpc::Pixel& s : found.shifts) largest = std::max(largest, std::hypot(s.x, s.y));
  CHECK(found.largest_shift > largest);
  const test::TempFolder folder("slopes");
  write_pointing(folder / "pointing.json", found);
  const Pointing again =
      given_pointing(views, read_pointing(folder / "pointing.json"), place.heights);
  std::vector<View> once = views, twice = views;
  apply_pointing(found, once);
  apply_pointing(again, twice);
  for (std::size_t i = 0; i < 3; ++i) {
    const rpc::Geodetic p = views[i].rpc.localize({50, 300}, place.heights.middle());
    CHECK(once[i].rpc.project(p).x == doctest::Approx(twice[i].rpc.project(p).x).epsilon(1e-9));
    CHECK(once[i].rpc.project(p).y == doctest::Approx(twice[i].rpc.project(p).y).epsilon(1e-9));
  }
  CHECK(*mean_across(again.after) < 0.4);
}

TEST_CASE("a file of shifts") {
  const test::TempFolder folder("pointing");
  const Place place = place_of(SceneKind::village, 192, 3, true, 40);
  std::vector<View> views = place.scene.views;
  spoil(views, errors_of(3, 5, 8));
  const Pointing found = measure_pointing(views, place.heights);
  REQUIRE(found.applied);
  write_pointing(folder / "pointing.json", found);
  const NamedShifts read = read_pointing(folder / "pointing.json");
  SUBCASE("gives the same cameras again") {
    const Pointing again = given_pointing(views, read, place.heights);
    CHECK(again.applied);
    CHECK(again.verdict == "as given");
    CHECK(*mean_across(again.before) == doctest::Approx(*mean_across(found.before)).epsilon(0.05));
    CHECK(*mean_across(again.after) == doctest::Approx(*mean_across(found.after)).epsilon(0.2));
    std::vector<View> once = views, twice = views;
    apply_pointing(found, once);
    apply_pointing(again, twice);
    for (std::size_t i = 0; i < 3; ++i) {
      CHECK(once[i].rpc == twice[i].rpc);
      CHECK(once[i].rpc.samp_off == views[i].rpc.samp_off + found.shifts[i].x);
      CHECK(once[i].rpc.line_off == views[i].rpc.line_off + found.shifts[i].y);
    }
  }
  SUBCASE("slopes that no camera can have") {
    NamedShifts steep = read;
    steep.at("place_002").slope = {{0, 0}, {{{0, 1e9}, {0, 0}}}};
    CHECK_THROWS_WITH_AS(given_pointing(views, steep, place.heights),
                         doctest::Contains("pointing: the slopes of place_002 suit no camera: "),
                         ConfigError);
  }
  SUBCASE("goes by cameras, then by names") {
    const auto shifts_again = [&] { return given_pointing(views, read, place.heights).shifts; };
    // as where every image of a delivery has one name, and comes in another order
    for (std::size_t i = 0; i < 3; ++i) views[i].name = found.names[(i + 1) % 3];
    for (std::size_t i = 0; i < 3; ++i) CHECK(shifts_again()[i].x == found.shifts[i].x);
    for (View& v : views) v.rpc = v.rpc.cropped(1, 1);
    for (std::size_t i = 0; i < 3; ++i) CHECK(shifts_again()[i].x == found.shifts[(i + 1) % 3].x);
  }
  SUBCASE("an image that is not in it") {
    views[1].name = "other", views[1].rpc.height_off += 1;
    CHECK_THROWS_WITH_AS(given_pointing(views, read, place.heights),
                         "pointing: no shift for other, expected one for every image (place_001, "
                         "place_002, place_003 given)",
                         ConfigError);
  }
  SUBCASE("files that are none") {
    const auto refusal = [&](const std::string& text) {
      std::ofstream(folder / "bad.json") << text;
      try {
        read_pointing(folder / "bad.json");
      } catch (const IoError& e) {
        return std::string(e.what()).substr((folder / "bad.json").string().size());
      }
      return std::string("accepted");
    };
    CHECK(refusal("{}") == ": no list `images`, expected one with name, shift_x and shift_y each");
    CHECK(refusal(R"({"images": [{"shift_x": 1}]})") ==
          ": an image without a name, expected name, shift_x and shift_y");
    CHECK(refusal(R"({"images": [{"name": "a", "shift_x": 1}]})") ==
          ": a: expected a number shift_y from -100000 to 100000");
    CHECK(refusal(R"({"images": [{"name": "a", "shift_x": 1e300, "shift_y": 2}]})") ==
          ": a: expected a number shift_x from -100000 to 100000");
    const std::string a = R"({"name": "a", "shift_x": 1, "shift_y": 2})";
    CHECK(refusal("{\"images\": [" + a + "," + a + "]}") ==
          ": a comes twice, expected every image once");
    CHECK(refusal("{\"images\": [" + a + "]}") == "accepted");
    const auto sloped = [&](const std::string& slope) {
      return refusal(R"({"images": [{"name": "a", "shift_x": 1, "shift_y": 2, "slope_x": )" +
                     slope + "}]}");
    };
    CHECK(sloped("[1, -2.5]") == "accepted");
    for (const char* bad : {"3", "[1]", "[1, 2, 3]", "[1, \"2\"]", "{}"})
      CHECK(sloped(bad) == ": a: expected two numbers slope_x from -1000 to 1000");
  }
}

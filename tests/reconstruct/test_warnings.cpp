// SPDX-License-Identifier: Apache-2.0
#include "satsurf/reconstruct/warnings.h"

#include <algorithm>
#include <limits>
#include <string>
#include <vector>

#include "tests/made_view.h"
#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::reconstruct;

using test::view_from;

namespace {

scene::Scene scene_of(std::vector<scene::View> views) {
  scene::Scene scene;
  scene.frame.zone = rpc::utm_zone_of(21, 10);
  const auto origin = rpc::utm_from_geodetic(scene.frame.zone, 21, 10);
  scene.frame.easting0 = origin[0], scene.frame.northing0 = origin[1], scene.frame.h0 = 20;
  scene.views = std::move(views);
  scene.z_range = {-20, 30};
  return scene;
}

/// A surface of a hundred cells in the middle of the range, of which nothing bad can be said.
Reconstruction good_surface() {
  Reconstruction made;
  made.dsm.z = Tensor({10, 10}, 3.0F);
  made.confidence = Tensor({10, 10}, 0.7F);
  made.completeness = 0.97;
  made.frame.h0 = 20, made.z_range = {-20, 30};
  return made;
}

std::vector<std::string> codes(const std::vector<Warning>& warnings) {
  std::vector<std::string> out;
  const auto known = warning_codes();
  for (const Warning& w : warnings) {
    CHECK(std::ranges::any_of(known, [&](const auto& k) { return k.first == w.code; }));
    CHECK(w.text.find('\n') == std::string::npos);
    out.push_back(w.code);
  }
  return out;
}
using Codes = std::vector<std::string>;

}  // namespace

TEST_CASE("warnings of the images") {
  scene::View a = view_from("a", 0.1), b = view_from("b", -0.15), c = view_from("c", 0.3);
  CHECK(codes(scene_warnings(scene_of({a, b, c}))).empty());
  CHECK(codes(scene_warnings(scene_of({view_from("a", 0.1, 1), view_from("b", -0.1, 1)}))) ==
        Codes{"ground_size"});
  CHECK(codes(scene_warnings(scene_of({view_from("a", 0.1, 0.1), view_from("b", -0.1, 0.1)}))) ==
        Codes{"ground_size"});
  CHECK(codes(scene_warnings(scene_of({a, view_from("b", 0.15), view_from("c", 0.17)}))) ==
        Codes{"little_parallax"});
  const auto much = scene_warnings(scene_of({view_from("a", 0.6), view_from("b", -0.6)}));
  REQUIRE(codes(much) == Codes{"much_parallax"});
  CHECK(much[0].text.find("a and b are 1.20 m") != std::string::npos);
  // one pair that is near enough is enough
  CHECK(codes(scene_warnings(scene_of({view_from("a", 0.6), view_from("b", -0.6), a}))).empty());

  a.sun_elevation_deg = b.sun_elevation_deg = 45;
  a.sun_azimuth_deg = 120, b.sun_azimuth_deg = 150;  // 21 degrees apart at this height
  CHECK(codes(scene_warnings(scene_of({a, b, c}))).empty());
  b.sun_azimuth_deg = 240;
  CHECK(codes(scene_warnings(scene_of({a, b, c}))) == Codes{"suns_apart"});
  b.sun_azimuth_deg = 120;
  a.date = "2015-02-15T16:12:08Z", b.date = "20151101120000", c.date = "not known";
  CHECK(codes(scene_warnings(scene_of({a, b, c}))).empty());
  c.date = "20170301";
  const auto years = scene_warnings(scene_of({a, b, c}));
  REQUIRE(codes(years) == Codes{"dates_apart"});
  CHECK(years[0].text.find("a and c are 2.0 years apart") != std::string::npos);
}

TEST_CASE("warnings of the surface") {
  CHECK(codes(surface_warnings(good_surface())).empty());
  Reconstruction made = good_surface();
  for (Index i = 0; i < 10; ++i) made.dsm.z[i] = 29.5F;
  const auto piled = surface_warnings(made);
  REQUIRE(codes(piled) == Codes{"end_of_range"});
  CHECK(
      piled[0].text.starts_with("10 % of the surface lie at the upper end of the height range, "
                                "50.0 m"));
  for (Index i = 0; i < 10; ++i) made.dsm.z[i] = -19.5F;
  CHECK(surface_warnings(made)[0].text.find("lower end of the height range, 0.0 m") !=
        std::string::npos);
  for (Index i = 4; i < 10; ++i) made.dsm.z[i] = std::numeric_limits<float>::quiet_NaN();
  CHECK(codes(surface_warnings(made)).empty());  // 4 of 94
  made = good_surface();
  made.confidence.fill(0.2F);
  CHECK(codes(surface_warnings(made)) == Codes{"low_confidence"});
  made = good_surface();
  made.completeness = 0.5;
  CHECK(codes(surface_warnings(made)) == Codes{"large_gaps"});
  made = good_surface();
  made.camera_fit_max_px = 0.4;
  CHECK(codes(surface_warnings(made)) == Codes{"camera_fit"});
}

TEST_CASE("warnings of the cameras") {
  const scene::Scene scene = scene_of({view_from("a", 0.1), view_from("b", -0.15)});
  scene::Pointing p;
  p.names = {"a", "b"}, p.shifts = {{0, 1}, {0, -1}}, p.observable = 1;
  p.before = {{.a = 0, .b = 1, .ties = 200, .across = 2, .along = {}}};
  p.after = {{.a = 0, .b = 1, .ties = 200, .across = 0.2, .along = {}}};
  p.applied = true, p.largest_shift = 1;
  SUBCASE("that agree once they are shifted") {
    p.shifts = {{0, 0.2}, {0, -0.2}};
    CHECK(codes(pointing_warnings(p, scene)).empty());
  }
  SUBCASE("that tie points do not connect") {
    p.after.clear(), p.applied = false, p.unconnected = {0, 1};
    p.verdict = "not estimated: b shares 3 tie points with another image, expected 20 or more";
    const auto told = pointing_warnings(p, scene);
    REQUIRE(codes(told) == Codes{"pointing_unknown"});
    CHECK(told[0].text.find("b shares 3 tie points") != std::string::npos);
  }
  SUBCASE("of which one is not connected") {
    p.shifts = {{0, 0.2}, {0, -0.2}}, p.unconnected = {1};
    const auto told = pointing_warnings(p, scene);
    REQUIRE(codes(told) == Codes{"pointing_unknown"});
    CHECK(told[0].text.starts_with("b shares too few tie points"));
  }
  SUBCASE("that are determined in part") {
    p.shifts = {{0, 0.2}, {0, -0.2}}, p.undetermined = 1;
    const auto told = pointing_warnings(p, scene);
    REQUIRE(codes(told) == Codes{"pointing_in_part"});
    CHECK(told[0].text.find("1 of the 2 combinations") != std::string::npos);
  }
  SUBCASE("that still disagree") {
    p.shifts = {{0, 0.2}, {0, -0.2}}, p.after[0].across = 1.004;
    const auto told = pointing_warnings(p, scene);
    REQUIRE(codes(told) == Codes{"pointing_residual"});
    CHECK(told[0].text.find("a and b still disagree by 1.004 px") != std::string::npos);
    p.after[0].ties = 7;  // chance
    CHECK(codes(pointing_warnings(p, scene)).empty());
    p.applied = false;  // then the first residuals count
    CHECK(codes(pointing_warnings(p, scene)) == Codes{"pointing_residual"});
  }
  SUBCASE("that may put all heights elsewhere") {
    // A lift of 1 m moves each view by half of 0.25 m of ground, which is 0.25 px of 0.5 m, and
    // shifts of 1 px of two images whose one combination is known have a deviation of sqrt 2:
    // sqrt(2) / (sqrt(2) 0.25) = 4 m.
    CHECK(codes(pointing_warnings(p, scene)).empty());
    for (rpc::Pixel& s : p.shifts) s.y *= 2;
    p.largest_shift = 2;
    const auto told = pointing_warnings(p, scene);
    REQUIRE(codes(told) == Codes{"heights_as_a_whole"});
    CHECK(told[0].text.find("off by 2.0 px may put all heights together 8 m") != std::string::npos);
    p.applied = false, p.before[0].across = 0.2;
    CHECK(codes(pointing_warnings(p, scene)).empty());
  }
}

TEST_CASE("warnings of the height range") {
  scene::UserScene user;
  user.range = {{-70, 150}, "found by comparing the images", {}, true};
  user.pointing.emplace().heights = rpc::HeightRange{20, 60};
  const auto told = range_warnings(user);
  REQUIRE(codes(told) == Codes{"wide_range"});
  CHECK(told[0].text.find("begins at -70 m") != std::string::npos);
  user.range.height_range.low = -39;  // 59 m below
  CHECK(codes(range_warnings(user)).empty());
  user.range.height_range.low = -70, user.pointing->heights->high = 120;  // a valley
  CHECK(codes(range_warnings(user)).empty());
  user.pointing->heights->high = 60, user.range.found = false;  // somebody's own
  CHECK(codes(range_warnings(user)).empty());
}

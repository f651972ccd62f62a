// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/view_choice.h"

#include <string>
#include <vector>

#include "tests/made_view.h"
#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::scene;

namespace {

/// A view of the common ground, or of what lies `east` m from there.
View view_from(const std::string& name, double west, double east = 0) {
  return test::view_from(name, west, 0.5, east);
}

View dated(View v, const std::string& date, double sun_elevation, double sun_azimuth) {
  v.date = date, v.sun_elevation_deg = sun_elevation, v.sun_azimuth_deg = sun_azimuth;
  return v;
}

ViewChoice chosen(const std::vector<View>& views, Index most) {
  return choose_views(
      views, [](const View&) { return 20.0; }, most);
}

}  // namespace

TEST_CASE("what is known of a pair") {
  const ViewPair pair = view_pair(dated(view_from("a", -0.1), "20200101", 60, 90),
                                  dated(view_from("b", 0.2, 10), "2020-03-01T10:00", 60, 270), 20);
  CHECK(pair.share == doctest::Approx(0.8).epsilon(0.01));
  CHECK(pair.base == doctest::Approx(0.3).epsilon(0.01));
  CHECK(pair.parallax == doctest::Approx(0.6).epsilon(0.01));
  CHECK(pair.suns_deg.value() == doctest::Approx(60));
  CHECK(pair.days.value() == doctest::Approx(60.8));
  const ViewPair apart = view_pair(view_from("a", 0), view_from("b", 0.2, 60), 20);
  CHECK(apart.share == 0);
  CHECK_FALSE(apart.suns_deg);
  CHECK_FALSE(apart.days);
}

TEST_CASE("quality of a pair") {
  const ViewPair good{.share = 1, .parallax = 0.6, .base = 0.3};
  CHECK(pair_quality(good) == 1);
  const auto with = [&](auto change) {
    ViewPair pair = good;
    change(pair);
    return pair_quality(pair);
  };
  CHECK(with([](ViewPair& p) { p.share = 0.5; }) == 0.5);
  CHECK(with([](ViewPair& p) { p.share = 0; }) == 0);
  CHECK(with([](ViewPair& p) { p.parallax = 5e-4; }) == 0);
  CHECK(with([](ViewPair& p) { p.base = 0.05; }) == doctest::Approx(0.5));
  CHECK(with([](ViewPair& p) { p.base = 1; }) == doctest::Approx(0.5));
  CHECK(with([](ViewPair& p) { p.suns_deg = 40; }) == doctest::Approx(0.5));
  CHECK(with([](ViewPair& p) { p.days = 365; }) == doctest::Approx(0.5));
}

TEST_CASE("the best views of many") {
  const View low = view_from("low", -0.15), straight = view_from("straight", 0.0),
             high = view_from("high", 0.15), twin = view_from("twin", 0.1503),
             aside = view_from("aside", 0.1, 40), away = view_from("away", 0.1, 500);
  SUBCASE("all that go together, in the order they came") {
    const ViewChoice choice = chosen({high, low, straight}, 5);
    CHECK(choice.kept == std::vector<Index>{0, 1, 2});
    CHECK(choice.left_out.empty());
  }
  SUBCASE("no more than are wanted") {
    const ViewChoice choice = chosen({aside, high, straight, low}, 3);
    CHECK(choice.kept == std::vector<Index>{1, 2, 3});
    REQUIRE(choice.left_out.size() == 1);
    CHECK(choice.left_out[0].label == "aside");
    CHECK(choice.left_out[0].why == "others go better together");
  }
  SUBCASE("views of another place are left out however many are wanted") {
    const ViewChoice choice = chosen({away, high, low}, 9);
    CHECK(choice.kept == std::vector<Index>{1, 2});
    CHECK(choice.left_out[0].why == "shares no ground with high");
  }
  SUBCASE("two from almost one direction go well with the others") {
    const ViewChoice choice = chosen({twin, high, low}, 2);
    CHECK(choice.kept == std::vector<Index>{0, 2});
  }
  SUBCASE("the light of one day before that of many") {
    const ViewChoice choice =
        chosen({dated(low, "2020-01-01", 50, 160), dated(straight, "2020-01-01", 50, 160),
                dated(high, "2022-01-01", 30, 160)},
               2);
    CHECK(choice.kept == std::vector<Index>{0, 1});
  }
  SUBCASE("nothing where no two go together") {
    CHECK(chosen({high, away}, 3).kept.empty());
    CHECK(chosen({high, high, high}, 3).kept.empty());
  }
}

TEST_CASE("parts of the ground have views of their own") {
  // two pairs beside one another, and a bridge between them
  const View west = view_from("west", -0.15), west2 = view_from("west2", 0.15),
             middle = view_from("middle", 0.05, 30), east = view_from("east", -0.15, 60),
             east2 = view_from("east2", 0.15, 60), away = view_from("away", 0.1, 500),
             twin = view_from("twin", 0.1501);
  const auto height = [](const View&) { return 20.0; };
  const std::vector<View> views{west, east, middle, west2, east2};
  CHECK(choose_views(views, height, 9).kept.size() < 5);
  const ViewChoice all = choose_views(views, height, 9, Together::connected);
  CHECK(all.kept == std::vector<Index>{0, 1, 2, 3, 4});
  const ViewChoice apart =
      choose_views({west, west2, away, twin, east}, height, 9, Together::connected);
  REQUIRE(apart.left_out.size() == 3);
  CHECK(apart.left_out[0].label == "away");
  CHECK(apart.left_out[0].why.starts_with("shares no ground with"));
  CHECK(apart.left_out[1].why == "seen from the same direction as west2");
}

TEST_CASE("of the views that show a part of the ground the best few") {
  const View low = view_from("low", -0.15), straight = view_from("straight", 0.0),
             high = view_from("high", 0.15), slow = view_from("slow", 0.02),
             twin = view_from("twin", 0.1501);
  const std::vector<char> all(10, 1), none(10, 0), left{1, 1, 1, 1, 1, 0, 0, 0, 0, 0},
      right{0, 0, 0, 0, 0, 1, 1, 1, 1, 1};
  // the pair with the best base
  CHECK(choose_for_ground({straight, slow, view_from("near", 0.05)}, {all, all, all}, 20, 2) ==
        std::vector<Index>{0, 2});
  // a view of nothing, and a second one from one direction, add nothing
  CHECK(choose_for_ground({low, high, straight, twin}, {all, all, none, all}, 20, 4) ==
        std::vector<Index>{0, 1});
  // ground that two views alone show is not left to the others
  CHECK(choose_for_ground({low, high, straight, slow, view_from("east", -0.1)},
                          {left, left, left, right, right}, 20,
                          4) == std::vector<Index>{0, 1, 3, 4});
  CHECK(choose_for_ground({low, high}, {left, right}, 20, 2).empty());
  CHECK(choose_for_ground({}, {}, 20, 2).empty());
}

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/labels.h"

#include <cmath>
#include <vector>

#include <doctest/doctest.h>

using namespace satsurf::app;

namespace {

constexpr Box kFigure{200, 200, 400, 400};

bool apart(const Box& a, const Box& b) {
  return std::abs(a.x - b.x) >= (a.width + b.width) / 2 ||
         std::abs(a.y - b.y) >= (a.height + b.height) / 2;
}

}  // namespace

TEST_CASE("labels: those of one place are spread around it, inside the figure") {
  std::vector<Box> labels(16, Box{395, 200, 20, 20});
  const std::vector<Box> marks{{395, 200, 10, 10}, {350, 200, 40, 40}};
  const std::vector<Box> placed = spread(labels, marks, kFigure, 18);
  REQUIRE(placed.size() == labels.size());
  for (std::size_t k = 0; k < placed.size(); ++k) {
    CHECK(placed[k].x <= 390);
    CHECK(std::hypot(placed[k].x - 395, placed[k].y - 200) < 120);
    for (std::size_t other = 0; other < k; ++other) CHECK(apart(placed[k], placed[other]));
    for (const Box& mark : marks) CHECK(apart(placed[k], mark));
  }
}

TEST_CASE("labels: one with room stays where it is, or goes outwards by as much as it must") {
  const std::vector<Box> two{{100, 200, 20, 20}, {300, 200, 20, 20}};
  CHECK(spread(two, {}, kFigure, 0)[1].x == 300);
  const std::vector<Box> beside = spread(two, {}, kFigure, 18);
  CHECK(beside[0].x == doctest::Approx(82));
  CHECK(beside[1].x == doctest::Approx(318));
  CHECK(beside[1].y == doctest::Approx(200));
}

TEST_CASE("labels: one that finds no room stays on its place") {
  const std::vector<Box> placed = spread({{5, 5, 20, 20}}, {}, {5, 5, 10, 10}, 4);
  CHECK(placed[0].x == 5);
  CHECK(spread({}, {}, kFigure, 0).empty());
}

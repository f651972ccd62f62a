// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/believable_span.h"

#include <algorithm>
#include <cstddef>
#include <optional>
#include <vector>

#include <doctest/doctest.h>

namespace satsurf {
namespace {

using rpc::HeightRange;
using scene::believable_span;
using scene::confirmed_span;
using scene::near_span;
using scene::Patch;
using scene::widened;

constexpr HeightRange kSearched{-300, 900};  // m

/// A patch whose heights rise evenly.
Patch patch(std::size_t pixels, float low, float high) {
  Patch heights;
  for (std::size_t k = 0; k < pixels; ++k)
    heights.push_back(low + (high - low) * static_cast<float>(k) / static_cast<float>(pixels - 1));
  return heights;
}

TEST_CASE("the believable span leaves out what chance finds") {
  std::vector<float> heights(2000, 10.f);
  for (int k = 0; k < 500; ++k) heights.push_back(static_cast<float>(k) / 25);  // 0 to 20 m
  for (int k = 0; k < 40; ++k) heights.push_back(static_cast<float>(37 * k % 900));
  const HeightRange span = believable_span(heights, {-100, 900});
  CHECK(span.low == doctest::Approx(0).epsilon(0.05));
  CHECK(span.high > 18);
  CHECK(span.high < 30);
}

TEST_CASE("a patch beyond a span has to be confirmed") {
  using Asked = std::vector<std::size_t>;
  Asked asked;
  std::vector<double> gaps;
  const auto span = [&](const std::vector<Patch>& patches, const Asked& true_ones) {
    asked.clear(), gaps.clear();
    return widened({0, 12}, patches, [&](std::size_t k, double gap) {
      asked.push_back(k), gaps.push_back(gap);
      return std::ranges::find(true_ones, k) != true_ones.end();
    });
  };
  CHECK(span({}, {}) == HeightRange{0, 12});
  CHECK(span({patch(60, 2, 28)}, {}) == HeightRange{0, 12});  // touches it
  CHECK(asked.empty());
  CHECK(span({patch(60, 80, 84)}, {}) == HeightRange{0, 12});
  CHECK(asked == Asked{0});
  CHECK(span({patch(60, 80, 84)}, {0}) == HeightRange{0, 84});
  CHECK(span({patch(60, -90, -86)}, {}) == HeightRange{0, 12});
  CHECK(span({patch(60, -90, -86)}, {0}) == HeightRange{-90, 12});
  // from the nearest on, in steps of 100 m
  CHECK(span({patch(150, 180, 184), patch(60, 80, 84)}, {0, 1}) == HeightRange{0, 184});
  CHECK(asked == Asked{1, 0});
  CHECK(gaps == std::vector<double>{68, 96});
  CHECK(span({patch(150, 180, 184), patch(60, 80, 84)}, {0}) == HeightRange{0, 12});
  CHECK(asked == Asked{1});
  CHECK(span({patch(60, -190, -186), patch(60, -90, -86)}, {0, 1}) == HeightRange{-190, 12});
  CHECK(gaps == std::vector<double>{86, 96});
}

TEST_CASE("heights within 20 m of the rest are close together") {
  const auto span = [](float low, float high) {
    std::vector<float> heights = patch(3000, 0, 12);
    for (const float z : patch(60, low, high)) heights.push_back(z);
    return near_span(std::move(heights), kSearched);
  };
  CHECK(span(24, 28) == HeightRange{0, 28});
  CHECK(span(-22, -18) == HeightRange{-22, 12});
  CHECK(span(36, 40).high < 13);
  CHECK(span(-40, -36).low > -1);
}

TEST_CASE("what one way alone finds far off is not believed") {
  const auto span = [](const HeightRange& a, const HeightRange& b) {
    const auto either = confirmed_span(a, b);
    CHECK(either == confirmed_span(b, a));
    return either.value();
  };
  CHECK(span({0, 40}, {-10, 20}) == HeightRange{-10, 40});
  CHECK(span({-240, 20}, {0, 30}) == HeightRange{-25, 30});
  CHECK(span({0, 20}, {5, 180}) == HeightRange{0, 45});
  CHECK(span({0, 20}, {100, 120}) == HeightRange{0, 120});
  const std::optional<HeightRange> one = HeightRange{3, 4};
  CHECK(confirmed_span(one, {}) == one);
  CHECK(confirmed_span({}, one) == one);
  CHECK_FALSE(confirmed_span({}, {}));
}

}  // namespace
}  // namespace satsurf

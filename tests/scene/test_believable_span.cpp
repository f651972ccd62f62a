// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/believable_span.h"

#include <optional>
#include <vector>

#include <doctest/doctest.h>

namespace satsurf {
namespace {

using rpc::HeightRange;
using scene::believable_span;
using scene::confirmed_span;
using scene::Patch;
using scene::span_of_patches;

constexpr HeightRange kSearched{-300, 900};  // m
constexpr Index kLarge = 98;                 // px

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

TEST_CASE("a patch far from all others has to be large") {
  const Patch ground = patch(3000, 0, 12);
  CHECK(span_of_patches({ground}, kSearched, kLarge) == HeightRange{0, 12});
  // within 50 m of the rest a small one counts
  CHECK(span_of_patches({ground, patch(60, 40, 44)}, kSearched, kLarge) == HeightRange{0, 44});
  CHECK(span_of_patches({ground, patch(60, 80, 84)}, kSearched, kLarge) == HeightRange{0, 12});
  CHECK(span_of_patches({ground, patch(60, -90, -86)}, kSearched, kLarge) == HeightRange{0, 12});
  CHECK(span_of_patches({ground, patch(100, 80, 84)}, kSearched, kLarge) == HeightRange{0, 84});
  CHECK(span_of_patches({ground, patch(100, -90, -86)}, kSearched, kLarge) == HeightRange{-90, 12});
  // and beyond 100 m none does
  CHECK(span_of_patches({ground, patch(150, 120, 124)}, kSearched, kLarge) == HeightRange{0, 12});
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

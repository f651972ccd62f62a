// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/rng.h"
#include "satsurf/reconstruct/level_water.h"

#include <algorithm>
#include <cmath>

#include <doctest/doctest.h>

using namespace satsurf;

namespace {

constexpr Index N = 160;
constexpr double kStep = 0.5;

/// Land at 10 m but for what `land` says, with a lake of a radius in its middle whose heights are noise,
/// 0 to 16 m, and not confirmed.
struct Lake {
  Tensor heights{{N, N}}, sigma{{N, N}, 0.3f}, confidence{{N, N}, 0.8f};

  template <class Land>
  Lake(double radius, Land&& land) {
    Rng rng(7);
    for (Index i = 0; i < N * N; ++i) {
      heights[i] = land(x(i), y(i));
      if (!wet(i, radius)) continue;
      heights[i] = static_cast<float>(rng.uniform(0, 16));
      sigma[i] = 8, confidence[i] = 0.1f;
    }
  }
  explicit Lake(double radius) : Lake(radius, [](double, double) { return 10.f; }) {}
  static double x(Index i) { return (static_cast<double>(i % N) + 0.5) * kStep; }
  static double y(Index i) { return (static_cast<double>(i / N) + 0.5) * kStep; }
  static bool wet(Index i, double radius) {
    return std::hypot(x(i) - 0.5 * N * kStep, y(i) - 0.5 * N * kStep) < radius;
  }
  Index level() {
    Tensor doubt = sigma.clone();
    const Index cells = reconstruct::level_water(heights, sigma, doubt, confidence, kStep);
    CHECK(std::equal(doubt.values().begin(), doubt.values().end(), sigma.values().begin(),
                     [](float a, float b) { return a == b || (std::isnan(a) && std::isnan(b)); }));
    return cells;
  }
};

Index wet_cells(double radius) {
  Index out = 0;
  for (Index i = 0; i < N * N; ++i) out += Lake::wet(i, radius);
  return out;
}

}  // namespace

TEST_CASE("a lake gets the height of its shore, and a jetty keeps its own") {
  Lake lake(30);
  // a jetty whose heights are sure, and a cell that has none
  const auto jetty = [](Index i) { return std::abs(Lake::y(i) - 40) < 3 && Lake::x(i) < 50; };
  Index over = 0;
  for (Index i = 0; i < N * N; ++i)
    if (jetty(i) && Lake::wet(i, 30))
      lake.heights[i] = 14, lake.sigma[i] = 0.3f, lake.confidence[i] = 0.8f, ++over;
  const Index hole = 50 * N + N / 2;
  lake.heights[hole] = lake.sigma[hole] = lake.confidence[hole] = NAN;
  const Tensor before = lake.confidence;
  CHECK(lake.level() == wet_cells(30) - over - 1);
  for (Index i = 0; i < N * N; ++i) {
    if (i == hole) {
      CHECK(std::isnan(lake.heights[i]));
      continue;
    }
    const bool water = Lake::wet(i, 30) && !jetty(i);
    CHECK(lake.heights[i] == (Lake::wet(i, 30) && !water ? 14.f : 10.f));
    CHECK(lake.sigma[i] == (water ? 1.5f : 0.3f));
    CHECK(lake.confidence[i] == before[i]);
  }
  CHECK(lake.level() == 0);  // nothing is in doubt any more
}

TEST_CASE("a lake is told by the doubt of the network that found it, not by the errors to expect") {
  Lake lake(30), other(30);
  Tensor doubt = lake.sigma.clone();
  lake.sigma = Tensor(doubt.shape(), 0.7f);
  CHECK(reconstruct::level_water(lake.heights, lake.sigma, doubt, lake.confidence, kStep) ==
        wet_cells(30));
  for (Index i = 0; i < N * N; ++i) CHECK(lake.sigma[i] == (Lake::wet(i, 30) ? 1.5f : 0.7f));
  Tensor sure(doubt.shape(), 0.7f);
  CHECK(reconstruct::level_water(other.heights, other.sigma, sure, other.confidence, kStep) == 0);
}

TEST_CASE("what is not sure beside a lake is levelled with it, some ten metres far") {
  Lake lake(30);
  for (Index i = 0; i < N * N; ++i)
    if (Lake::wet(i, 35) && !Lake::wet(i, 30)) lake.heights[i] = 12, lake.sigma[i] = 1.2f;
  CHECK(lake.level() == wet_cells(35));
  for (Index i = 0; i < N * N; ++i) CHECK(lake.heights[i] == 10.f);
}

TEST_CASE("a lake that goes on beyond the images has the height of the shore that they show") {
  Lake lake(30);
  Index left = 0;
  for (Index i = 0; i < N * N; ++i)
    if (Lake::x(i) > 65)
      lake.heights[i] = lake.sigma[i] = lake.confidence[i] = NAN;
    else
      left += Lake::wet(i, 30);
  CHECK(lake.level() == left);
}

TEST_CASE("houses on the shore, a jetty that is too low and a slight fall change little") {
  Lake lake(30, [](double x, double y) {
    if (y < 20 && std::fmod(x, 10.0) < 8) return 22.f;
    return std::hypot(x - 68, y - 60) < 5 ? -5.f : 10.f + 0.01f * static_cast<float>(x);
  });
  CHECK(lake.level() == wet_cells(30));
  const Index middle = N / 2 * N + N / 2;
  CHECK(lake.heights[middle] > 10.f);
  CHECK(lake.heights[middle] < 10.8f);
}

TEST_CASE("where no level shore surrounds what is in doubt, it stays") {
  const auto stays = [](Lake lake) {
    const Tensor heights = lake.heights, sigma = lake.sigma;
    CHECK(lake.level() == 0);
    for (Index i = 0; i < N * N; ++i) {
      CHECK(lake.heights[i] == heights[i]);
      CHECK(lake.sigma[i] == sigma[i]);
    }
  };
  SUBCASE("on a slope") {
    stays(Lake(30, [](double x, double) { return 10.f + 0.3f * static_cast<float>(x); }));
  }
  SUBCASE("small") { stays(Lake(25)); }
  SUBCASE("a courtyard") {
    stays(
        Lake(30, [](double x, double y) { return std::hypot(x - 40, y - 40) < 36 ? 40.f : 10.f; }));
  }
  SUBCASE("a wood") {
    Lake lake(30);
    for (Index i = 0; i < N * N; ++i)
      if (Lake::wet(i, 30)) lake.heights[i] = 12 + 0.5f * lake.heights[i];
    // its fringe is not sure, and lower
    for (Index i = 0; i < N * N; ++i)
      if (Lake::wet(i, 36) && !Lake::wet(i, 30)) lake.sigma[i] = 1.5f;
    stays(lake);
  }
  SUBCASE("with confirmed heights") {
    Lake lake(30);
    for (float& c : lake.confidence.values()) c = 0.6f;
    stays(lake);
  }
  SUBCASE("sure of its heights") {
    Lake lake(30);
    for (float& s : lake.sigma.values()) s = std::min(s, 2.f);
    stays(lake);
  }
  SUBCASE("without a sure shore") {
    Lake lake(30);
    for (Index i = 0; i < N * N; ++i)
      if (!Lake::wet(i, 30)) lake.sigma[i] = 2;
    stays(lake);
  }
}

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"
#include "satsurf/core/rng.h"
#include "satsurf/reconstruct/level_water.h"
#include "satsurf/reconstruct/untextured.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include <Eigen/Dense>
#include <doctest/doctest.h>

using namespace satsurf;

namespace {

constexpr Index N = 96, kFrom = 16, kTo = 80, kRim = 3;  // cells
constexpr double kStep = 0.5;

/// A hall 10 m high on textured ground that is known well. Of its roof, of one colour, the rim is known, and
/// the rest in doubt.
struct Hall {
  Tensor heights{{N, N}, 0.f}, sigma{{N, N}, 0.3f}, colours{{3, N, N}};

  Hall() {
    Rng rng(11);
    for (Index i = 0; i < N * N; ++i) {
      for (Index c = 0; c < 3; ++c)
        colours[c * N * N + i] = roof(i) ? -1.f : static_cast<float>(rng.uniform(-0.5, 0.5));
      if (roof(i)) heights[i] = 10;
      if (inner(i)) heights[i] += static_cast<float>(rng.uniform(-4, 6)), sigma[i] = 8;
    }
  }
  static bool within(Index i, Index from, Index to) {
    return std::min(i / N, i % N) >= from && std::max(i / N, i % N) < to;
  }
  static bool roof(Index i) { return within(i, kFrom, kTo); }
  static bool inner(Index i) { return within(i, kFrom + kRim, kTo - kRim); }
  Index even() { return reconstruct::even_untextured(heights, sigma, colours, kStep); }
  /// Whether nothing happens to it.
  bool stays() {
    const Tensor z = heights.clone(), s = sigma.clone();
    const Index cells = even();
    return cells == 0 && std::ranges::equal(z.values(), heights.values()) &&
           std::ranges::equal(s.values(), sigma.values());
  }
};

}  // namespace

TEST_CASE("a roof in doubt goes along with its rim, and the ground stays") {
  Hall hall;
  const Index inside = kTo - kFrom - 2 * kRim;
  CHECK(hall.even() == inside * inside);
  for (Index i = 0; i < N * N; ++i) {
    if (Hall::roof(i)) {
      CHECK(hall.heights[i] == doctest::Approx(10).epsilon(0.05));
      CHECK(hall.sigma[i] >= 0.29f);
      CHECK(hall.sigma[i] < 2);
    } else {
      CHECK(hall.heights[i] == doctest::Approx(0).epsilon(1e-3));
      CHECK(hall.sigma[i] == doctest::Approx(0.3));
    }
  }
  CHECK(hall.sigma[N / 2 * N + N / 2] > hall.sigma[(kFrom + kRim) * N + N / 2]);
}

TEST_CASE(
    "what has texture, or is not in doubt, or is in doubt along a rim alone, stays as it is") {
  Hall textured, sure, rim;
  Rng rng(3);
  for (Index i = 0; i < N * N; ++i) {
    textured.colours[i] += Hall::roof(i) ? static_cast<float>(rng.uniform(-0.2, 0.2)) : 0;
    sure.sigma[i] = 0.9f;
    rim.sigma[i] = Hall::within(i, kFrom, kTo) && !Hall::within(i, kFrom + 1, kTo - 1) ? 8 : 0.3f;
  }
  CHECK(textured.stays());
  CHECK(sure.stays());
  CHECK(rim.stays());
}

TEST_CASE("roofs of two colours keep their heights, and holes part nothing") {
  Hall hall;
  for (Index i = 0; i < N * N; ++i) {
    if (!Hall::roof(i) || i % N < N / 2) continue;
    hall.heights[i] += 6;
    for (Index c = 0; c < 3; ++c) hall.colours[c * N * N + i] = 1;
  }
  const Index hole = 40 * N + 30;
  hall.heights[hole] = hall.sigma[hole] = NAN;
  hall.even();
  for (Index i = 0; i < N * N; ++i) {
    if (!Hall::roof(i)) continue;
    if (i == hole) {
      CHECK(std::isnan(hall.heights[i]));
      CHECK(std::isnan(hall.sigma[i]));
    } else {
      CHECK(hall.heights[i] == doctest::Approx(i % N < N / 2 ? 10 : 16).epsilon(0.05));
    }
  }
}

// A street around a roof is as level as a shore, and of heights that are found anywhere some lie as low.
TEST_CASE("a roof that is evened out first is not taken for water") {
  constexpr Index M = 160;
  Tensor heights({M, M}, 0.f), sigma({M, M}, 0.3f), confidence({M, M}, 0.8f), colours({1, M, M});
  Rng rng(2);
  for (Index i = 0; i < M * M; ++i) {
    colours[i] = static_cast<float>(rng.uniform(-0.5, 0.5));
    if (std::min(i / M, i % M) < 30 || std::max(i / M, i % M) >= 130) continue;
    colours[i] = -1, heights[i] = static_cast<float>(rng.uniform(-1, 13));
    sigma[i] = 8, confidence[i] = 0.1f;
  }
  const auto levelled = [&](const Tensor& z, const Tensor& s) {
    Tensor level = z.clone(), error = s.clone(), doubt = sigma.clone();
    return reconstruct::level_water(level, error, doubt, confidence, kStep);
  };
  CHECK(levelled(heights, sigma) == 100 * 100);
  Tensor evened = heights.clone(), error = sigma.clone();
  CHECK(reconstruct::even_untextured(evened, error, colours, kStep) == 100 * 100);
  CHECK(evened[80 * M + 80] == doctest::Approx(6).epsilon(0.1));
  CHECK(levelled(evened, error) == 0);
}

// All cells alike and in doubt: every two neighbours draw at one another with 30 d.
TEST_CASE("heights and expected errors are those of the equations, solved densely") {
  constexpr Index H = 12, W = 15, P = H * W;
  Tensor heights({H, W}), sigma({H, W}), colours({1, H, W}, 0.25f);
  Rng rng(5);
  Eigen::VectorXd found(P), expected(P), weight(P);
  for (Index i = 0; i < P; ++i) {
    heights[i] = static_cast<float>(300 + (i % W < 7 ? 0 : 20) + rng.uniform(-1, 1));
    sigma[i] = static_cast<float>(rng.uniform(2, 12));
    found[i] = static_cast<double>(heights[i]), expected[i] = static_cast<double>(sigma[i]);
    weight[i] = 1 / (expected[i] * expected[i]);
  }
  Eigen::VectorXd z = found;
  Eigen::MatrixXd A;
  for (int pass = 0; pass < 3; ++pass) {
    A = weight.asDiagonal();
    const auto draw = [&](Index a, Index b) {
      const double pull = 30 / std::pow(1 + std::pow((z[a] - z[b]) / 3, 2), 2);
      A(a, a) += pull, A(b, b) += pull, A(a, b) -= pull, A(b, a) -= pull;
    };
    for (Index i = 0; i < P; ++i) {
      if (i % W + 1 < W) draw(i, i + 1);
      if (i / W + 1 < H) draw(i, i + W);
    }
    z = A.ldlt().solve(weight.cwiseProduct(found));
  }
  const Eigen::VectorXd error = A.ldlt().solve(weight.cwiseProduct(expected));
  CHECK(reconstruct::even_untextured(heights, sigma, colours, 1.0) == P);
  for (Index i = 0; i < P; ++i) {
    CHECK(std::abs(static_cast<double>(heights[i]) - z[i]) < 0.02);
    CHECK(std::abs(static_cast<double>(sigma[i]) - error[i]) < 0.02);
  }
  CHECK(z[0] < 305);
  CHECK(z[W - 1] > 315);
}

TEST_CASE("maps of different sizes are refused") {
  Tensor heights({4, 5}, 1.f), sigma({4, 5}, 1.f), small({4, 4}, 1.f);
  CHECK_THROWS_AS(reconstruct::even_untextured(heights, small, Tensor({3, 4, 5}), 1.0), ShapeError);
  CHECK_THROWS_AS(reconstruct::even_untextured(heights, sigma, Tensor({3, 4, 4}), 1.0), ShapeError);
}

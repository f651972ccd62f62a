// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/ops/height_cross_entropy.h"
#include "satsurf/ops/mode_height.h"
#include "satsurf/ops/softmax.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "tests/gradcheck.h"

using namespace satsurf;
using test::gradcheck;
using test::normal;

namespace {

/// Evenly spaced heights [B D H W] from 10 m on that differ from pixel to pixel.
BasicTensor<double> spaced(const Shape& shape, double interval) {
  BasicTensor<double> z(shape);
  const Index D = shape[1], P = shape[2] * shape[3];
  for (Index i = 0; i < z.count(); ++i)
    z[i] = 10 + 0.3 * static_cast<double>(i % P) + interval * static_cast<double>(i / P % D);
  return z;
}

BasicVar<double> softmax_of(const BasicTensor<double>& logits, const BasicTensor<double>& z) {
  return height_distribution(BasicVar<double>(logits), z).probability;
}

}  // namespace

TEST_CASE("mode_height by hand") {
  // A surface at 3 and one hypothesis that stands out at 0; two modes as good as each other; all at the last.
  const double probability[3][5] = {
      {0.35, 0, 0.2, 0.25, 0.2}, {0.25, 0.25, 0, 0.25, 0.25}, {0, 0, 0, 0.25, 0.75}};
  BasicTensor<double> p({1, 5, 1, 3}), z({1, 5, 1, 3});
  for (Index d = 0; d < 5; ++d)
    for (Index x = 0; x < 3; ++x) {
      p[3 * d + x] = probability[x][d];
      z[3 * d + x] = static_cast<double>(d);
    }
  const auto h = mode_height(BasicVar<double>(p), z, 1).value();
  CHECK(h[0] == doctest::Approx((0.2 * 2 + 0.25 * 3 + 0.2 * 4) / 0.65));
  CHECK(h[1] == doctest::Approx(0.5));  // about 0, the first of equals
  CHECK(h[2] == doctest::Approx(0.25 * 3 + 0.75 * 4));
  const auto only = mode_height(BasicVar<double>(p), z, 0).value();
  CHECK(only[0] == 0);  // the most probable one
  const auto all = mode_height(BasicVar<double>(p), z, 9).value();
  CHECK(all[0] == doctest::Approx(0.4 + 0.75 + 0.8));
}

TEST_CASE("mode_height: hypotheses fewer than three") {
  BasicTensor<double> two({1, 2, 1, 1}), z({1, 2, 1, 1});
  two[0] = 0.4, two[1] = 0.6, z[0] = 10, z[1] = 20;
  CHECK(mode_height(BasicVar<double>(two), z, 1).value()[0] == doctest::Approx(16));
  const BasicTensor<double> one({1, 1, 1, 1}, 1.0), at({1, 1, 1, 1}, 7.0);
  CHECK(mode_height(BasicVar<double>(one), at, 1).value()[0] == doctest::Approx(7));
}

TEST_CASE("mode_height is that of a search one pixel after the other") {
  const Shape shape{2, 9, 4, 5};
  const auto z = spaced(shape, 0.7), p = softmax_of(normal(shape, 8), z).value();
  for (const Index radius : {0, 1, 3}) {
    CAPTURE(radius);
    const auto h = mode_height(BasicVar<double>(p), z, radius).value();
    for (Index b = 0; b < 2; ++b)
      for (Index pixel = 0; pixel < 20; ++pixel) {
        const auto of = [&](const BasicTensor<double>& volume, Index d) {
          return volume[(b * 9 + d) * 20 + pixel];
        };
        double highest = 0, mass = 0, moment = 0;
        Index mode = 0;
        for (Index d = 0; d < 9; ++d) {
          double sum = 0;
          for (Index k = std::max<Index>(0, d - std::min<Index>(1, radius));
               k <= std::min<Index>(8, d + std::min<Index>(1, radius)); ++k)
            sum += of(p, k);
          if (sum > highest) highest = sum, mode = d;
        }
        for (Index d = 0; d < 9; ++d)
          if (std::abs(d - mode) <= radius) mass += of(p, d), moment += of(p, d) * of(z, d);
        REQUIRE(h[b * 20 + pixel] == doctest::Approx(moment / mass));
      }
  }
}

TEST_CASE("mode_height: gradient and threads") {
  const Shape shape{2, 6, 3, 5};
  const auto z = spaced(shape, 0.7), p = softmax_of(normal(shape, 5), z).value();
  CHECK(gradcheck([&](const test::DoubleVars& v) { return mode_height(v[0], z, 1); }, {p}));
  const auto run = [&](int threads) {
    set_threads(threads);
    const Var x(p.cast<float>(), true);
    const Var h = mode_height(x, z.cast<float>(), 2);
    h.backward(Tensor(h.shape(), 1.f));
    set_threads(0);
    return std::pair(h.value(), x.grad());
  };
  const auto one = run(1), two = run(2);
  for (Index i = 0; i < one.first.count(); ++i) REQUIRE(one.first[i] == two.first[i]);
  for (Index i = 0; i < one.second.count(); ++i) REQUIRE(one.second[i] == two.second[i]);
}

TEST_CASE("height_cross_entropy by hand") {
  // Hypotheses 0, 2, 4, 6 m with probabilities 0.1, 0.2, 0.3, 0.4; the truth of four pixels.
  BasicTensor<double> p({1, 4, 1, 4}), z({1, 4, 1, 4});
  for (Index i = 0; i < 16; ++i) {
    p[i] = 0.1 * static_cast<double>(i / 4 + 1);
    z[i] = 2 * static_cast<double>(i / 4);
  }
  const auto loss = [&](const std::vector<double>& truth, const std::vector<double>& weight) {
    BasicTensor<double> t({1, 1, 4}), w({1, 1, 4});
    for (Index i = 0; i < 4; ++i) t[i] = truth[i], w[i] = weight[i];
    return height_cross_entropy(BasicVar<double>(p), z, t, w).value().item();
  };
  const auto nats = [](double q) { return -std::log(q); };
  CHECK(loss({2, 0, 0, 0}, {1, 0, 0, 0}) == doctest::Approx(nats(0.2)));
  CHECK(loss({3.5, 0, 0, 0}, {2, 0, 0, 0}) == doctest::Approx(0.25 * nats(0.2) + 0.75 * nats(0.3)));
  CHECK(loss({6.9, -0.9, 0, 0}, {1, 3, 0, 0}) == doctest::Approx((nats(0.4) + 3 * nats(0.1)) / 4));
  CHECK(loss({7.1, -1.1, 4, 0}, {1, 1, 1, 0}) == doctest::Approx(nats(0.3)));  // two out of reach
  CHECK(loss({NAN, 99, -99, 8}, {0, 1, 1, 1}) == 0);

  BasicTensor<double> t({1, 1, 4}), w({1, 1, 4}, 2.0);
  const double truth[] = {7.1, 6.9, -0.9, -1.1};
  for (Index i = 0; i < 4; ++i) t[i] = truth[i];
  w[2] = 0;
  const auto inside = within_hypotheses(z, t, w);
  CHECK(inside[0] == 0);
  CHECK(inside[1] == 2);
  CHECK(inside[2] == 0);
  CHECK(inside[3] == 0);

  const BasicTensor<double> alone({1, 1, 1, 4}, 5.0), weights({1, 1, 4}, 2.0);
  const auto reached = within_hypotheses(alone, t, weights);
  for (Index i = 0; i < 4; ++i) CHECK(reached[i] == 2);
}

TEST_CASE("height_cross_entropy: gradient through the softmax, least at the truth, threads") {
  const Shape shape{2, 6, 3, 4}, flat{2, 3, 4};
  const auto z = spaced(shape, 0.7);
  BasicTensor<double> truth(flat), weight(flat);
  Rng rng(11);
  for (Index i = 0; i < truth.count(); ++i) {
    truth[i] = 10 + 0.3 * static_cast<double>(i % 12) + rng.uniform(-1, 5);
    weight[i] = rng.uniform(0.5, 2);
  }
  CHECK(gradcheck(
      [&](const test::DoubleVars& v) {
        return height_cross_entropy(height_distribution(v[0], z).probability, z, truth, weight);
      },
      {normal(shape, 12)}));
  // The distribution whose loss is least has the truth for its mean.
  const BasicVar<double> logits(BasicTensor<double>({1, 4, 1, 1}), true);
  BasicVar<double> moving = logits;
  const auto line = spaced({1, 4, 1, 1}, 1);
  BasicTensor<double> t({1, 1, 1}, 11.3), one({1, 1, 1}, 1.0);
  for (int k = 0; k < 3000; ++k) {
    moving.clear_grad();
    height_cross_entropy(height_distribution(moving, line).probability, line, t, one).backward();
    for (Index i = 0; i < 4; ++i) moving.mutable_value()[i] -= moving.grad()[i];
  }
  CHECK(height_distribution(moving, line).height.value()[0] == doctest::Approx(11.3).epsilon(1e-3));

  const auto run = [&](int threads) {
    set_threads(threads);
    const Shape large{2, 6, 70, 90};
    const Var x(
        height_distribution(Var(normal(large, 3).cast<float>()), spaced(large, 1).cast<float>())
            .probability.value(),
        true);
    const Var loss = height_cross_entropy(x, spaced(large, 1).cast<float>(),
                                          Tensor({2, 70, 90}, 500.f), Tensor({2, 70, 90}, 1.f));
    loss.backward();
    set_threads(0);
    return std::pair(loss.value(), x.grad());
  };
  const auto single = run(1), both = run(2);
  CHECK(single.first[0] == both.first[0]);
  CHECK(single.first[0] > 0);
  for (Index i = 0; i < single.second.count(); ++i) REQUIRE(single.second[i] == both.second[i]);
}

TEST_CASE("mode_height and height_cross_entropy refuse") {
  const BasicVar<double> p(BasicTensor<double>({1, 3, 2, 2}));
  const BasicTensor<double> z({1, 3, 2, 2}), map({1, 2, 2});
  CHECK_THROWS_AS(mode_height(p, BasicTensor<double>({1, 3, 2, 1}), 1), ShapeError);
  CHECK_THROWS_WITH_AS(mode_height(p, z, -1), "mode_height: radius is -1, expected 0 or more",
                       ConfigError);
  CHECK_THROWS_AS(height_cross_entropy(p, z, BasicTensor<double>({1, 2, 1}), map), ShapeError);
  CHECK_THROWS_AS(within_hypotheses(z, map, BasicTensor<double>({2, 2})), ShapeError);
  CHECK_THROWS_WITH_AS(
      within_hypotheses(BasicTensor<double>({1, 0, 2, 2}), map, map),
      "within_hypotheses: heights has shape [1,0,2,2], expected at least one hypothesis",
      ShapeError);
}

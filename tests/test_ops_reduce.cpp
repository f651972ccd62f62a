// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/ops/loss.h"
#include "satsurf/ops/reduce.h"

#include <cmath>
#include <limits>

#include "tests/gradcheck.h"

using namespace satsurf;
using test::gradcheck;
using test::normal;

TEST_CASE("sum and mean") {
  const BasicVar<double> x(BasicTensor<double>::from({2, 3}, {1, 2, 3, 4, 5, 6.5}));
  CHECK(sum(x).shape() == Shape{});
  CHECK(sum(x).value().item() == 21.5);
  CHECK(mean(x).value().item() == doctest::Approx(21.5 / 6));
  CHECK(sum(BasicVar<double>(BasicTensor<double>({0, 3}))).value().item() == 0);
  CHECK_THROWS_WITH_AS(mean(BasicVar<double>(BasicTensor<double>({0, 3}))),
                       "mean: x has shape [0,3], expected at least one element", ShapeError);
}

TEST_CASE("float sums are taken in double") {
  const Index n = 3'000'001;  // 0.1f added up in float would be off by some percent
  const Var x(Tensor({n}, 0.1f));
  CHECK(sum(x).value().item() ==
        doctest::Approx(static_cast<double>(n) * static_cast<double>(0.1f)).epsilon(1e-7));
  CHECK(mean(x).value().item() == 0.1f);
}

TEST_CASE("reduction gradients") {
  const auto x = normal({2, 3, 5}, 1);
  CHECK(gradcheck([](const test::DoubleVars& v) { return sum(v[0]); }, {x}));
  CHECK(gradcheck([](const test::DoubleVars& v) { return mean(v[0]); }, {x}));
}

TEST_CASE("losses by hand") {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const BasicVar<double> x(BasicTensor<double>::from({4}, {1, 2, 3, 4}), true);
  const auto target = BasicTensor<double>::from({4}, {1.5, -1, nan, 4}),
             weight = BasicTensor<double>::from({4}, {2, 1, 0, 1});
  // errors -0.5 and 3 and 0 with weights 2, 1, 1; beta 2: 0.25 / 4, 3 - 1, 0
  const auto l = smooth_l1(x, target, weight, 2.0);
  CHECK(l.value().item() == doctest::Approx((2 * 0.0625 + 2) / 4));
  l.backward();
  const double slopes[] = {2 * -0.25 / 4, 1.0 / 4, 0, 0};
  for (Index i = 0; i < 4; ++i) CHECK(x.grad()[i] == doctest::Approx(slopes[i]));
  CHECK(mse(x, target, weight).value().item() == doctest::Approx((2 * 0.25 + 9) / 4));
}

TEST_CASE("a loss without any weight is zero, and so is its gradient") {
  const BasicVar<double> x(BasicTensor<double>({5}, 3.0), true);
  const BasicTensor<double> target({5}, std::numeric_limits<double>::quiet_NaN()), none({5}, 0.0);
  for (const auto& l : {smooth_l1(x, target, none, 1.0), mse(x, target, none)}) {
    CHECK(l.value().item() == 0);
    l.backward();
    for (Index i = 0; i < 5; ++i) CHECK(x.grad()[i] == 0);
  }
}

TEST_CASE("no weights means equal weights") {
  const auto x = normal({3, 7}, 2), target = normal({3, 7}, 3);
  const BasicTensor<double> ones({3, 7}, 1.0);
  const BasicVar<double> v(x);
  CHECK(smooth_l1(v, target, {}, 0.7).value().item() ==
        smooth_l1(v, target, ones, 0.7).value().item());
  CHECK(mse(v, target, {}).value().item() == mse(v, target, ones).value().item());
}

TEST_CASE("loss gradients") {
  const auto target = normal({2, 3, 5}, 4);
  auto weight = normal({2, 3, 5}, 5);
  for (double& w : weight.values()) w = std::abs(w);
  weight[7] = 0;
  auto x = normal({2, 3, 5}, 6);
  int linear = 0;
  for (Index i = 0; i < x.count(); ++i) {  // off the second derivative's jump at |e| = beta
    if (std::abs(std::abs(x[i] - target[i]) - 0.8) < 1e-3) x[i] += 0.01;
    linear += std::abs(x[i] - target[i]) > 0.8 ? 1 : 0;
  }
  REQUIRE(linear > 5);
  REQUIRE(linear < 25);
  CHECK(gradcheck([&](const test::DoubleVars& v) { return smooth_l1(v[0], target, weight, 0.8); },
                  {x}));
  CHECK(
      gradcheck([&](const test::DoubleVars& v) { return smooth_l1(v[0], target, {}, 0.8); }, {x}));
  CHECK(gradcheck([&](const test::DoubleVars& v) { return mse(v[0], target, weight); }, {x}));
  CHECK(gradcheck([&](const test::DoubleVars& v) { return mse(v[0], target, {}); }, {x}));
}

TEST_CASE("reductions and losses give the same bits for any number of threads") {
  const auto x = normal({70001}, 7).cast<float>(), target = normal({70001}, 8).cast<float>();
  const auto run = [&](int threads) {
    set_threads(threads);
    const Var a(x, true);
    const Var l = smooth_l1(a, target, {}, 0.5f), s = sum(a), m = mse(a, target, {});
    l.backward();
    m.backward();
    s.backward();
    set_threads(0);
    return std::vector<Tensor>{l.value(), s.value(), m.value(), a.grad()};
  };
  const auto one = run(1), two = run(2);
  for (std::size_t k = 0; k < one.size(); ++k)
    for (Index i = 0; i < one[k].count(); ++i) REQUIRE(one[k][i] == two[k][i]);
}

TEST_CASE("losses refuse") {
  const Var x(Tensor({2, 3}));
  CHECK_THROWS_WITH_AS(mse(x, Tensor({3, 2}), {}),
                       "mse: target has shape [3,2], expected [2,3] from x", ShapeError);
  CHECK_THROWS_WITH_AS(smooth_l1(x, Tensor({2, 3}), Tensor({2}), 1.0f),
                       "smooth_l1: weight has shape [2], expected [2,3] from x", ShapeError);
  CHECK_THROWS_WITH_AS(smooth_l1(x, Tensor({2, 3}), {}, 0.0f),
                       "smooth_l1: beta is 0.000000, expected a positive number", ConfigError);
}

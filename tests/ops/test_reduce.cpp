// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/ops/loss.h"
#include "satsurf/ops/loss_kernels.h"
#include "satsurf/ops/reduce.h"

#include <cmath>
#include <limits>

#include "tests/gradcheck.h"
#include "tests/isa_variants.h"

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
  BasicTensor<double> mask({2, 3, 5}), valid({2, 3, 5});
  for (Index i = 0; i < x.count(); ++i) {
    mask[i] = i % 3 == 0 ? 1 : 0;
    valid[i] = i % 6 != 5 ? 1 : 0;
  }
  CHECK(gradcheck([&](const test::DoubleVars& v) { return masked_mean(v[0], mask, valid); }, {x}));
  CHECK(gradcheck([&](const test::DoubleVars& v) { return masked_mean(v[0], mask, {}); }, {x}));
}

TEST_CASE("masked means divide by all valid elements") {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const BasicVar<double> x(BasicTensor<double>::from({5}, {1, 2, nan, 4, 8}));
  const auto mask = BasicTensor<double>::from({5}, {1, 0, 0, 1, 0.5}),
             valid = BasicTensor<double>::from({5}, {1, 1, 0, 1, 1});
  CHECK(masked_mean(x, mask, valid).value().item() == 9.0 / 4);
  CHECK(masked_mean(x, mask, {}).value().item() == 9.0 / 5);
  const BasicTensor<double> none({5}, 0.0);
  CHECK(masked_mean(x, none, none).value().item() == 0);
  CHECK(masked_mean(x, none, valid).value().item() == 0);
  CHECK_THROWS_WITH_AS(masked_mean(x, BasicTensor<double>({4}), valid),
                       "masked_mean: mask has shape [4], expected [5] from x", ShapeError);
  CHECK_THROWS_WITH_AS(masked_mean(x, mask, BasicTensor<double>({1, 5})),
                       "masked_mean: valid has shape [1,5], expected [5] from x", ShapeError);
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

TEST_CASE_TEMPLATE("loss kernels of every instruction set", T, float, double) {
  const double tolerance = std::is_same_v<T, float> ? 1e-6 : 1e-14;
  const T nan = std::numeric_limits<T>::quiet_NaN(), guard = T(9), beta = T(0.8), factor = T(0.3);
  constexpr Index kMost = 5003;  // sums go to double many times
  const auto x = normal({kMost}, 1).cast<T>();
  auto target = normal({kMost}, 2).cast<T>(), weight = normal({kMost}, 3).cast<T>();
  for (Index i = 0; i < kMost; ++i) weight[i] = std::abs(weight[i]);
  for (Index i = 3; i < kMost; i += 7) weight[i] = 0;
  auto holes = target.clone();
  for (Index i = 3; i < kMost; i += 7) holes[i] = nan;
  for (const auto& k : test::kernel_variants<LossKernels<T>>())
    for (const Index n : {1, 2, 3, 4, 7, 8, 15, 16, 17, 33, 5003})
      for (const bool weighted : {false, true})
        for (const Distance distance : {Distance::squared, Distance::smooth_l1}) {
          CAPTURE(k.name);
          CAPTURE(n);
          CAPTURE(weighted);
          const T* w = weighted ? weight.data() : nullptr;
          const T* to = weighted ? holes.data() : target.data();
          double sums[2], loss = 0, total = 0;
          BasicTensor<T> d({kMost}, guard);
          k.sums(distance, beta, n, x.data(), to, w, sums);
          k.backward(distance, beta, factor, n, x.data(), to, w, d.data());
          for (Index i = 0; i < kMost; ++i) {
            const double wi = weighted ? static_cast<double>(weight[i]) : 1.0;
            const double e = static_cast<double>(x[i]) - static_cast<double>(target[i]);
            const double b = static_cast<double>(beta), size = std::abs(e);
            const bool squared = distance == Distance::squared, inner = size < b;
            if (i < n) {
              loss += wi * (squared ? e * e : inner ? e * e / (2 * b) : size - b / 2);
              total += wi;
            }
            const double slope = squared ? 2 * e : inner ? e / b : e < 0 ? -1 : 1;
            const double want = i < n ? 9 + static_cast<double>(factor) * wi * slope : 9;
            REQUIRE(std::abs(static_cast<double>(d[i]) - want) <= 20 * tolerance);
          }
          CHECK(std::abs(sums[0] - loss) <= tolerance * loss);
          CHECK(std::abs(sums[1] - total) <= tolerance * total);
        }
}

TEST_CASE("a NaN that has a weight stays visible in a loss") {
  for (const auto& k : test::kernel_variants<LossKernels<float>>())
    for (const Distance distance : {Distance::squared, Distance::smooth_l1}) {
      CAPTURE(k.name);
      const float nan = std::numeric_limits<float>::quiet_NaN();
      const float x[] = {1, nan, 3}, target[] = {0, 0, 0};
      float d[] = {0, 0, 0};
      double sums[2];
      k.sums(distance, 1.0f, 3, x, target, nullptr, sums);
      k.backward(distance, 1.0f, 1.0f, 3, x, target, nullptr, d);
      CHECK(sums[0] != sums[0]);
      CHECK(d[1] != d[1]);
      CHECK(d[0] == d[0]);
    }
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
    const Var k = masked_mean(a, target, x);
    k.backward();
    l.backward();
    m.backward();
    s.backward();
    set_threads(0);
    return std::vector<Tensor>{l.value(), s.value(), m.value(), k.value(), a.grad()};
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

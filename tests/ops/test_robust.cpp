// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/ops/concat.h"
#include "satsurf/ops/robust.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "tests/gradcheck.h"

using namespace satsurf;
using test::gradcheck;
using test::normal;
using Double = BasicTensor<double>;

namespace {

struct Size {
  Index H, W;
};

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kInf = std::numeric_limits<double>::infinity();

double sorted_median(std::vector<double> v) {
  std::sort(v.begin(), v.end());
  const std::size_t n = v.size();
  return n == 0 ? 0 : (v[(n - 1) / 2] + v[n / 2]) / 2;
}

RobustScale<double> scale_of(const std::vector<double>& values,
                             const std::vector<double>& valid = {}) {
  return robust_scale(std::span(values), std::span(valid));
}

}  // namespace

TEST_CASE("median and median absolute deviation by hand") {
  const auto odd = scale_of({5, 1, 100, 3, 2});  // deviations 2, 2, 97, 0, 1
  CHECK(odd.median == 3);
  CHECK(odd.mad == 2);
  const auto even = scale_of({1, 2, 4, 11});  // median 3; deviations 2, 1, 1, 8
  CHECK(even.median == 3);
  CHECK(even.mad == 1.5);
  const auto masked = scale_of({1, kNan, 2, 4, 900, 11}, {1, 0, 1, 1, 0, 1});
  CHECK(masked.median == 3);
  CHECK(masked.mad == 1.5);
  CHECK(scale_of({7}).median == 7);
  CHECK(scale_of({7}).mad == 0);
  CHECK(scale_of({}).median == 0);
  CHECK(scale_of({3, 4}, {0, 0}).mad == 0);
  const auto far = scale_of({1e308, 1.2e308, 1.4e308, 1.6e308});  // their sums overflow
  CHECK(far.median == doctest::Approx(1.3e308));
}

TEST_CASE("values that are not finite") {
  CHECK(std::isnan(scale_of({1, kNan, 3}).median));
  CHECK(std::isnan(scale_of({1, kNan, 3}).mad));
  for (std::size_t at = 0; at < 9; ++at) {  // wherever selection would meet it
    std::vector<double> values{5, 1, 8, 3, 9, 2, 7, 4, 6};
    values[at] = kNan;
    CHECK(std::isnan(scale_of(values).median));
    CHECK(std::isnan(scale_of(values).mad));
  }
  CHECK(scale_of({1, kInf, 3, 2, -kInf}).median == 2);  // gross errors, but few
  CHECK(scale_of({1, kInf, 3, 2, -kInf}).mad == 1);
  CHECK(std::isnan(scale_of({kInf, kInf, 3}).median));
}

TEST_CASE_TEMPLATE("robust normalisation equals sorting", T, float, double) {
  const double tolerance = std::is_same_v<T, float> ? 1e-5 : 1e-13;
  for (const Size size : {Size{13, 11}, Size{1, 1}, Size{1, 2}, Size{8, 6}, Size{31, 17}}) {
    CAPTURE(size.H);
    CAPTURE(size.W);
    const Index P = size.H * size.W, N = 3;
    Double x = normal({N, size.H, size.W}, 1, 5).cast<T>().template cast<double>(),
           valid({N, size.H, size.W}, 1.0);
    const auto dice = normal({N, size.H, size.W}, 2);
    for (Index i = 0; i < x.count(); ++i) {
      if (dice[i] > 0.5 && i % P > 0) valid[i] = 0, x[i] = kNan;
      if (i / P == 2) valid[i] = 0;  // the last map has no valid pixel
    }
    const auto y = robust_normalised(x.cast<T>(), valid.cast<T>(), T(0.1));
    for (Index n = 0; n < N; ++n) {
      std::vector<double> kept, apart;
      for (Index i = n * P; i < (n + 1) * P; ++i)
        if (valid[i] != 0) kept.push_back(x[i]);
      const double median = sorted_median(kept);
      for (const double v : kept) apart.push_back(std::abs(v - median));
      const double mad = sorted_median(apart);
      for (Index i = n * P; i < (n + 1) * P; ++i) {
        const double want = valid[i] != 0 ? (x[i] - median) / (mad + 0.1) : 0;
        REQUIRE(std::abs(static_cast<double>(y[i]) - want) <= tolerance * (1 + std::abs(want)));
      }
    }
  }
}

TEST_CASE("a missing mask means that all pixels count") {
  const auto x = normal({2, 5, 7}, 3);
  const auto a = robust_normalised(x, {}, 0.2),
             b = robust_normalised(x, Double({2, 5, 7}, 1.0), 0.2);
  for (Index i = 0; i < x.count(); ++i) REQUIRE(a[i] == b[i]);
}

TEST_CASE("robust normalisation ignores offset, unit and a few gross errors") {
  const auto x = normal({1, 9, 9}, 4);
  auto scaled = x.clone(), spoiled = x.clone();
  for (double& v : scaled.values()) v = 1000 + 50 * v;
  for (const Index i : {3, 40}) spoiled[i] = 1e9;
  const auto a = robust_normalised(x, {}, 1e-12), b = robust_normalised(scaled, {}, 1e-12),
             c = robust_normalised(spoiled, {}, 1e-12);
  for (Index i = 0; i < x.count(); ++i) {
    REQUIRE(b[i] == doctest::Approx(a[i]));
    if (i != 3 && i != 40) REQUIRE(std::abs(c[i] - a[i]) < 0.15 * (1 + std::abs(a[i])));
  }
}

TEST_CASE("robust normalisation gradient") {
  // Fixed columns -1, 0 and 1 hold the median and, with as many variables on either side of each,
  // the median absolute deviation too, so that differences see both constant as backward does.
  const Double fixed = Double::from({2, 1, 3}, {-1, 0, 1, 0, 1, -1});
  Double x = normal({2, 1, 8}, 5);
  for (Index i = 0; i < x.count(); ++i) {
    const double size = i % 4 < 2 ? 0.1 + 0.05 * static_cast<double>(i)  // below 1
                                  : 1.5 + 0.3 * static_cast<double>(i);  // above
    x[i] = i % 2 == 0 ? size : -size;
  }
  const auto op = [&](const Double& valid) {
    return [&, valid](const test::DoubleVars& v) {
      return robust_normalised(concat(test::DoubleVars{v[0], BasicVar<double>(fixed)}, 2), valid,
                               0.3);
    };
  };
  CHECK(gradcheck(op({}), {x}));
  Double valid({2, 1, 11}, 1.0);
  for (const Index i : {0, 1, 2, 3}) valid[i] = 0;  // one of each kind
  CHECK(gradcheck(op(valid), {x}));

  const BasicVar<double> v(normal({2, 3, 5}, 6), true);
  const auto g = normal({2, 3, 5}, 7);
  robust_normalised(v, {}, 0.3).backward(g);
  for (Index i = 0; i < 30; ++i) {  // also at the median itself
    const std::span<const double> map(v.value().data() + i / 15 * 15, 15);
    REQUIRE(v.grad()[i] == doctest::Approx(g[i] / (robust_scale(map, {}).mad + 0.3)));
  }
}

TEST_CASE("both forms of robust normalisation agree") {
  const auto x = normal({2, 5, 7}, 8);
  const auto a = robust_normalised(x, {}, 0.2);
  const auto b = robust_normalised(BasicVar<double>(x), {}, 0.2).value();
  for (Index i = 0; i < x.count(); ++i) REQUIRE(a[i] == b[i]);
}

TEST_CASE("robust normalisation gives the same bits for any number of threads") {
  const auto x = normal({5, 41, 37}, 9).cast<float>(), g = normal({5, 41, 37}, 10).cast<float>();
  const auto run = [&](int threads) {
    set_threads(threads);
    const Var v(x, true);
    const Var y = robust_normalised(v, {}, 0.1f);
    y.backward(g);
    set_threads(0);
    return std::vector<Tensor>{y.value(), v.grad()};
  };
  const auto one = run(1), two = run(2);
  for (std::size_t k = 0; k < one.size(); ++k)
    for (Index i = 0; i < one[k].count(); ++i) REQUIRE(one[k][i] == two[k][i]);
}

TEST_CASE("robust normalisation refuses") {
  CHECK_THROWS_WITH_AS(robust_normalised(Tensor({4, 5}), {}, 0.1f),
                       "robust_normalised: x has shape [4,5], expected [N H W]", ShapeError);
  CHECK_THROWS_WITH_AS(
      robust_normalised(Tensor({2, 4, 5}), Tensor({2, 5, 4}), 0.1f),
      "robust_normalised: valid has shape [2,5,4], expected [N H W] with N=2 from x, H=4 from x, "
      "W=5 from x",
      ShapeError);
  CHECK_THROWS_WITH_AS(robust_normalised(Tensor({2, 4, 5}), {}, 0.f),
                       "robust_normalised: eps is 0.000000, expected a positive number",
                       ConfigError);
  CHECK_THROWS_WITH_AS(scale_of({1, 2, 3}, {1, 1}),
                       "robust_scale: valid has 2 elements, expected 3 from values", ShapeError);
}

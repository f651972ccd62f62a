// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/concat.h"
#include "satsurf/ops/reduce.h"
#include "satsurf/ops/visible_mean.h"

#include <cmath>

#include "tests/gradcheck.h"

using namespace satsurf;
using test::normal;

namespace {

constexpr Index J = 3, K = 2, D = 4, H = 3, W = 5, P = H * W;

Index at(Index j, Index k, Index d, Index i) { return ((j * (K + 1) + k) * D + d) * P + i; }

/// Costs of three pairs; pixel 0 is seen by no view, others by some of them at some heights.
BasicTensor<double> costs() {
  auto out = normal({J, K + 1, D, H, W}, 1);
  Rng rng(2);
  for (Index j = 0; j < J; ++j)
    for (Index d = 0; d < D; ++d)
      for (Index i = 0; i < P; ++i) out[at(j, K, d, i)] = i > 0 && rng.uniform() < 0.7 ? 1 : 0;
  return out;
}

double visibility(const BasicTensor<double>& c, const BasicTensor<double>& l, Index j, Index i) {
  double most = 0;
  for (Index d = 0; d < D; ++d)
    if (c[at(j, K, d, i)] > 0)
      most = std::max(most, 1e-4 + (1 - 1e-4) / (1 + std::exp(-l[(j * D + d) * P + i])));
  return most;
}

}  // namespace

TEST_CASE("visible_mean is what the formula says") {
  const auto c = costs(), l = normal({J, 1, D, H, W}, 3, 2);
  const auto out = visible_mean(BasicVar<double>(c), BasicVar<double>(l)).value();
  REQUIRE(out.shape() == Shape{K + 1, D, H, W});
  for (Index d = 0; d < D; ++d)
    for (Index i = 0; i < P; ++i) {
      double sum = 0, weighted[K] = {};
      for (Index j = 0; j < J; ++j) {
        const double w = c[at(j, K, d, i)] * visibility(c, l, j, i);
        sum += w;
        for (Index k = 0; k < K; ++k) weighted[k] += w * c[at(j, k, d, i)];
      }
      for (Index k = 0; k < K; ++k)
        CHECK(out[at(0, k, d, i)] == doctest::Approx(sum > 0 ? weighted[k] / sum : 0));
      CHECK(out[at(0, K, d, i)] == doctest::Approx(sum / J));
    }
  const auto single = visible_mean(Var(c.cast<float>()), Var(l.cast<float>())).value();
  for (Index i = 0; i < out.count(); ++i)
    CHECK(static_cast<double>(single[i]) == doctest::Approx(out[i]).epsilon(1e-5));
}

TEST_CASE("visible_mean: a view that sees a point nowhere well has no say at any height") {
  BasicTensor<double> c({2, 2, 2, 1, 1}, 1.0), l({2, 1, 2, 1, 1}, 40.0);
  c[0] = 5, c[1] = 7;   // costs of the first pair
  c[4] = 90, c[5] = 3;  // of the second, in which something stands before the point
  l[2] = l[3] = -40;
  const auto out = visible_mean(BasicVar<double>(c), BasicVar<double>(l)).value();
  CHECK(out[0] == doctest::Approx(5 + 85e-4 / 1.0001));
  CHECK(out[1] == doctest::Approx(7 - 4e-4 / 1.0001));
  CHECK(out[2] == doctest::Approx(0.50005));
  l[3] = 40;  // visible at one height, it is at both
  const auto both = visible_mean(BasicVar<double>(c), BasicVar<double>(l)).value();
  CHECK(both[0] == doctest::Approx(47.5));
  CHECK(both[1] == doctest::Approx(5));
}

TEST_CASE(
    "visible_mean: where no view counts for anything all have their say, and nothing overflows") {
  Tensor c({2, 2, 1, 1, 1}, 1.f);
  c[0] = 2, c[2] = 4;
  Var costs(c, true), logits(Tensor({2, 1, 1, 1, 1}, -1000.f), true);
  const Var out = visible_mean(costs, logits);
  CHECK(out.value()[0] == doctest::Approx(3));
  CHECK(out.value()[1] == doctest::Approx(1e-4));
  sum(out).backward();
  CHECK(costs.grad()[0] == doctest::Approx(0.5));
  for (const float g : logits.grad().values()) CHECK(g == 0);
}

TEST_CASE("visible_mean: gradients") {
  const auto seen = costs();
  // Which views see a point is no variable: the costs alone are.
  BasicTensor<double> d({J, K, D, H, W}), m({J, 1, D, H, W});
  for (Index j = 0; j < J; ++j)
    for (Index i = 0; i < D * P; ++i) {
      for (Index k = 0; k < K; ++k) d[(j * K + k) * D * P + i] = seen[at(j, k, 0, i)];
      m[j * D * P + i] = seen[at(j, K, 0, i)];
    }
  const auto f = [&](const test::DoubleVars& v) {
    return visible_mean(concat<double>({v[0], BasicVar<double>(m)}, 1), v[1]);
  };
  CHECK(test::gradcheck(f, {d, normal({J, 1, D, H, W}, 3, 2)}));
}

TEST_CASE("visible_mean names what does not fit") {
  const auto fails = [&](const Shape& costs, const Shape& logits) {
    CHECK_THROWS_AS(visible_mean(BasicVar<double>(BasicTensor<double>(costs)),
                                 BasicVar<double>(BasicTensor<double>(logits))),
                    ShapeError);
  };
  fails({2, 3, 4, 5, 6}, {2, 2, 4, 5, 6});
  fails({2, 1, 4, 5, 6}, {2, 1, 4, 5, 6});
  fails({2, 3, 4, 5, 6}, {1, 1, 4, 5, 6});
  fails({2, 3, 4, 5, 6}, {2, 1, 4, 5, 5});
}

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/ops/norm.h"
#include "satsurf/ops/pointwise_kernels.h"

#include <cmath>
#include <limits>

#include "tests/gradcheck.h"
#include "tests/isa_variants.h"

using namespace satsurf;
using test::gradcheck;
using test::normal;

namespace {

double act(Activation activation, double z) {
  if (activation == Activation::relu) return std::max(z, 0.0);
  if (activation == Activation::gelu) return z * 0.5 * std::erfc(-z / std::sqrt(2.0));
  return z;
}

/// The definition, group by group.
BasicTensor<double> group_norm_ref(const BasicTensor<double>& x, const BasicTensor<double>& gamma,
                                   const BasicTensor<double>& beta, Index groups,
                                   Activation activation, double epsilon) {
  const Index B = x.dim(0), C = x.dim(1), S = x.shape().count(2, x.rank()), K = C / groups;
  BasicTensor<double> y(x.shape());
  for (Index b = 0; b < B; ++b)
    for (Index g = 0; g < groups; ++g) {
      const Index first = (b * C + g * K) * S, count = K * S;
      double mean = 0, variance = 0;
      for (Index i = 0; i < count; ++i) mean += x[first + i] / static_cast<double>(count);
      for (Index i = 0; i < count; ++i)
        variance += (x[first + i] - mean) * (x[first + i] - mean) / static_cast<double>(count);
      for (Index i = 0; i < count; ++i) {
        const Index c = g * K + i / S;
        y[first + i] = act(
            activation, gamma[c] * (x[first + i] - mean) / std::sqrt(variance + epsilon) + beta[c]);
      }
    }
  return y;
}

template <class T>
BasicVar<T> group_norm(const BasicVar<T>& x, const BasicVar<T>& gamma, const BasicVar<T>& beta,
                       Index groups, Activation activation = Activation::none) {
  return materialise(group_normalised(x, gamma, beta, groups, activation));
}

constexpr Activation kActivations[] = {Activation::none, Activation::relu, Activation::gelu};

}  // namespace

TEST_CASE("group_normalised agrees with its definition") {
  const std::pair<Shape, Index> cases[] = {{{2, 6, 5, 7}, 3},      {{1, 4, 3, 5, 2}, 4},
                                           {{3, 4, 1}, 2},         {{2, 1, 33}, 1},
                                           {{1, 2, 3, 40, 61}, 1}, {{2, 3, 17}, 1},
                                           {{1, 2, 131, 257}, 2}};  // the last is cut into chunks
  for (const auto& [shape, groups] : cases)
    for (const Activation activation : kActivations) {
      CAPTURE(shape.str());
      const auto x = normal(shape, 1), gamma = normal({shape[1]}, 2), beta = normal({shape[1]}, 3);
      const auto want = group_norm_ref(x, gamma, beta, groups, activation, 1e-5);
      using VD = BasicVar<double>;
      const auto y = group_norm(VD(x), VD(gamma), VD(beta), groups, activation).value();
      const auto f = group_norm(Var(x.cast<float>()), Var(gamma.cast<float>()),
                                Var(beta.cast<float>()), groups, activation)
                         .value();
      for (Index i = 0; i < x.count(); ++i) {
        REQUIRE(std::abs(y[i] - want[i]) < 1e-12);
        REQUIRE(std::abs(static_cast<double>(f[i]) - want[i]) < 1e-5);
      }
    }
}

TEST_CASE("group_normalised keeps its precision where the mean is large") {
  auto x = normal({2, 4, 9, 11}, 5);
  const auto gamma = normal({4}, 6), beta = normal({4}, 7);
  for (double& v : x.values()) v += 1e3;
  for (double& v : x.values()) v = static_cast<float>(v);
  const auto want = group_norm_ref(x, gamma, beta, 2, Activation::none, 1e-5);
  const auto y =
      group_norm(Var(x.cast<float>()), Var(gamma.cast<float>()), Var(beta.cast<float>()), 2)
          .value();
  for (Index i = 0; i < x.count(); ++i) CHECK(std::abs(static_cast<double>(y[i]) - want[i]) < 3e-4);
}

TEST_CASE("group_normalised of a constant is its offset") {
  const BasicVar<double> x(BasicTensor<double>({1, 2, 6}, 7.0)), one(BasicTensor<double>({2}, 1.0));
  const auto beta = BasicTensor<double>::from({2}, {0.5, -2.0});
  const auto y = group_norm(x, one, BasicVar<double>(beta), 1).value();
  for (Index i = 0; i < 12; ++i) CHECK(y[i] == beta[i / 6]);
}

TEST_CASE("a NaN spoils its group and no other") {
  Tensor x({1, 4, 5}, 1.0f);
  for (Index i = 0; i < 20; ++i) x[i] = static_cast<float>(i);
  x[3] = std::numeric_limits<float>::quiet_NaN();
  for (const Activation activation : kActivations) {
    const auto y =
        group_norm(Var(x), Var(Tensor({4}, 1.0f)), Var(Tensor({4}, 1.0f)), 2, activation).value();
    for (Index i = 0; i < 20; ++i) CHECK(std::isnan(y[i]) == (i < 10));
  }
}

TEST_CASE("group_normalised gradient") {
  for (const Activation activation : kActivations) {
    CAPTURE(static_cast<int>(activation));
    const std::pair<Shape, Index> cases[] = {
        {{2, 6, 3, 5}, 3}, {{3, 4, 7}, 1}, {{2, 3, 2, 5, 3}, 3}};
    for (const auto& [shape, groups] : cases) {
      const auto x = normal(shape, 11), gamma = normal({shape[1]}, 12),
                 beta = normal({shape[1]}, 13);
      const Index k = groups;
      CHECK(gradcheck(
          [=](const test::DoubleVars& v) { return group_norm(v[0], v[1], v[2], k, activation); },
          {x, gamma, beta}));
    }
  }
}

TEST_CASE("gradients of normalised values") {
  for (const Activation a : kActivations) {
    CHECK(gradcheck(
        [=](const test::DoubleVars& v) { return materialise(Normalised<double>(v[0], v[1], a)); },
        {normal({2, 3, 5, 4}, 40), normal({3, 2, 3}, 41)}));
    CHECK(gradcheck(
        [=](const test::DoubleVars& v) {
          return add(Normalised<double>(v[0], v[1], a), Normalised<double>(v[2]));
        },
        {normal({2, 3, 5}, 42), normal({3, 2, 3}, 43), normal({2, 3, 5}, 44)}));
    // the same value on both sides, and its normalisation made of it
    CHECK(gradcheck(
        [=](const test::DoubleVars& v) {
          const auto n = group_normalised(v[0], v[1], v[2], 2, a);
          return add(n, Normalised<double>(v[0], n.affine, Activation::gelu));
        },
        {normal({2, 4, 6}, 45), normal({4}, 46), normal({4}, 47)}));
  }
}

TEST_CASE("a map added along the depth of a volume") {
  const auto volume = normal({2, 3, 4, 5, 6}, 60), map = normal({2, 3, 5, 6}, 61),
             affine = normal({3, 2, 3}, 62);
  for (const Activation a : kActivations) {
    for (const int n : {1, 2}) {
      set_threads(n);
      const NoGrad no_grad;
      const auto out =
          add_map(Normalised<double>(BasicVar<double>(volume), BasicVar<double>(affine), a),
                  BasicVar<double>(map))
              .value();
      for (Index i = 0; i < out.count(); ++i) {
        const Index row = i / 120, p = i % 30;
        const double z = affine[6 + row] * (volume[i] - affine[row]) + affine[12 + row];
        REQUIRE(out[i] == doctest::Approx(act(a, z) + map[row * 30 + p]));
      }
    }
    set_threads(0);
    CHECK(gradcheck(
        [=](const test::DoubleVars& v) { return add_map(Normalised<double>(v[0], v[1], a), v[2]); },
        {normal({2, 3, 4, 2, 3}, 63), normal({3, 2, 3}, 64), normal({2, 3, 2, 3}, 65)}));
  }
  const BasicVar<double> x(volume), wrong(normal({2, 3, 5, 7}, 66));
  CHECK_THROWS_AS(add_map(Normalised<double>(x), wrong), ShapeError);
}

TEST_CASE("moments of channels") {
  // a mean far above the spread, and channels of more than one chunk
  auto x = normal({2, 3, 20011}, 50);
  for (Index i = 0; i < x.count(); ++i) x[i] += 1000;
  const ChannelMoments got = channel_moments(x.cast<float>());
  REQUIRE(got.size() == 6);
  for (Index row = 0; row < 6; ++row) {
    double mean = 0, m2 = 0;
    for (Index i = 0; i < 20011; ++i) mean += x[row * 20011 + i] / 20011;
    for (Index i = 0; i < 20011; ++i) m2 += std::pow(x[row * 20011 + i] - mean, 2);
    const Moments& m = got[static_cast<std::size_t>(row)];
    CHECK(m.count == 20011);
    CHECK(std::abs(m.mean - mean) < 1e-5);
    CHECK(std::abs(m.m2 / m2 - 1) < 1e-5);
  }
  Moments none;
  none.merge({});
  CHECK(none.count == 0);
  none.merge(got[0]);
  CHECK(none.mean == got[0].mean);
}

TEST_CASE("normalised values refuse what does not fit") {
  const BasicVar<double> x(BasicTensor<double>({2, 3, 4})), flat(BasicTensor<double>({2, 3}));
  CHECK_THROWS_WITH_AS(materialise(Normalised<double>(x, flat, Activation::none)),
                       "materialise: affine has shape [2,3], expected [3,2,3] for x [2,3,4]",
                       ShapeError);
  CHECK_THROWS_WITH_AS(materialise(Normalised<double>(flat)),
                       "materialise: x has shape [2,3], expected [B C ...] of rank 3 to 5",
                       ShapeError);
  CHECK_THROWS_AS(add(Normalised<double>(x),
                      Normalised<double>(BasicVar<double>(BasicTensor<double>({2, 3, 5})))),
                  ShapeError);
}

TEST_CASE("group_normalised works where only some inputs want a gradient") {
  const auto x = normal({2, 4, 6}, 15);
  for (const Activation activation : kActivations) {
    const auto run = [&](bool wants_x, bool wants_gamma) {
      const BasicVar<double> a(x, wants_x), gamma(normal({4}, 16), wants_gamma),
          beta(normal({4}, 17), false);
      group_norm(a, gamma, beta, 2, activation).backward(x);
      return std::pair(a.grad(), gamma.grad());
    };
    const auto both = run(true, true), first = run(true, false), second = run(false, true);
    CHECK(first.second.empty());
    CHECK(second.first.empty());
    for (Index i = 0; i < x.count(); ++i) CHECK(first.first[i] == both.first[i]);
    for (Index i = 0; i < 4; ++i) CHECK(second.second[i] == both.second[i]);
  }
}

TEST_CASE_TEMPLATE("norm kernels of every instruction set", T, float, double) {
  const double tolerance = std::is_same_v<T, float> ? 5e-6 : 1e-13;
  const NormRow<T> row{T(-0.4), T(1.3), T(0.1)};
  const auto values = normal({3000}, 20).cast<T>(), slopes = normal({3000}, 21).cast<T>();
  for (const auto& k : test::kernel_variants<PointwiseKernels<T>>())
    for (const Index n : {1, 3, 16, 19, 1100, 2999})
      for (const Activation activation : kActivations) {
        CAPTURE(k.name);
        CAPTURE(n);
        const T *x = values.data() + 1, *g = slopes.data() + 1;
        double sums[2], want[2] = {0, 0}, pair[2], unused[2], want_pair[2] = {0, 0};
        BasicTensor<T> y({n + 1}, T(9)), sum({n + 1}, T(9)), dx({n + 1}, T(9)), line({n + 1}, T(9));
        k.norm_sums(n, x, T(0.25), sums);
        k.norm_apply(n, x, row, activation, nullptr, y.data());
        k.norm_apply(n, x, row, activation, sum.data(), sum.data());
        BasicTensor<T> stored({n + 1}, T(9));
        k.norm_backward(n, x, g, row, activation, true, dx.data(), pair);
        k.norm_backward(n, x, g, row, activation, false, stored.data(), unused);
        k.norm_backward(n, x, g, row, activation, true, nullptr, unused);
        CHECK(stored[n] == T(9));
        for (Index i = 0; i < n; ++i)
          CHECK(static_cast<double>(dx[i] - stored[i]) == doctest::Approx(9).epsilon(1e-5));
        k.norm_add_linear(n, x, row, line.data());
        CHECK(unused[0] == pair[0]);
        CHECK(unused[1] == pair[1]);
        for (Index i = 0; i < n; ++i) {
          const double e = static_cast<double>(x[i]) - 0.25;
          want[0] += e;
          want[1] += e * e;
          const double centred = static_cast<double>(x[i]) + 0.4, z = 1.3 * centred + 0.1, h = 1e-6;
          const double slope = static_cast<double>(g[i]) *
                               (act(activation, z + h) - act(activation, z - h)) / (2 * h);
          want_pair[0] += slope;
          want_pair[1] += slope * centred;
          REQUIRE(std::abs(static_cast<double>(line[i]) - (9 + z)) < 3 * tolerance);
          if (std::abs(z) < 1e-5) continue;  // the kink
          REQUIRE(std::abs(static_cast<double>(y[i]) - act(activation, z)) < tolerance);
          REQUIRE(std::abs(static_cast<double>(sum[i]) - (9 + act(activation, z))) < 3 * tolerance);
          REQUIRE(std::abs(static_cast<double>(dx[i]) - (9 + 1.3 * slope)) <
                  std::max(3 * tolerance, 1e-8));
        }
        for (int m = 0; m < 2; ++m) {
          CHECK(std::abs(sums[m] - want[m]) < 10 * tolerance * std::sqrt(static_cast<double>(n)));
          CHECK(std::abs(pair[m] - want_pair[m]) <
                std::max(10 * tolerance, 1e-7) * std::sqrt(static_cast<double>(n)));
        }
        for (const auto& t : {y, sum, dx, line}) CHECK(t[n] == T(9));
      }
}

TEST_CASE("group_normalised gives the same bits for any number of threads") {
  const auto x = normal({2, 4, 3, 97, 61}, 30).cast<float>(),
             g = normal({2, 4, 3, 97, 61}, 31).cast<float>();
  for (const Activation activation : kActivations) {
    const auto run = [&](int threads) {
      set_threads(threads);
      const Var a(x, true), gamma(Tensor({4}, 1.5f), true), beta(Tensor({4}, 0.2f), true);
      const Var y = group_norm(a, gamma, beta, 2, activation);
      y.backward(g);
      set_threads(0);
      return std::vector<Tensor>{y.value(), a.grad(), gamma.grad(), beta.grad()};
    };
    const auto one = run(1), two = run(2);
    for (std::size_t k = 0; k < one.size(); ++k)
      for (Index i = 0; i < one[k].count(); ++i) REQUIRE(one[k][i] == two[k][i]);
  }
}

TEST_CASE("group_normalised refuses") {
  const auto call = [](const Shape& x, Index gamma, Index beta, Index groups) {
    return group_norm(BasicVar<double>(BasicTensor<double>(x)),
                      BasicVar<double>(BasicTensor<double>({gamma})),
                      BasicVar<double>(BasicTensor<double>({beta})), groups);
  };
  CHECK_THROWS_WITH_AS(
      call({2, 4}, 4, 4, 2),
      "group_normalised: x has shape [2,4], expected a non-empty [B C ...] of rank 3 to 5",
      ShapeError);
  CHECK_THROWS_WITH_AS(call({2, 4, 3}, 3, 4, 2),
                       "group_normalised: gamma has shape [3], expected [C] with C=4 from x",
                       ShapeError);
  CHECK_THROWS_WITH_AS(call({2, 4, 3}, 4, 5, 2),
                       "group_normalised: beta has shape [5], expected [C] with C=4 from x",
                       ShapeError);
  CHECK_THROWS_WITH_AS(call({2, 4, 3}, 4, 4, 3),
                       "group_normalised: 3 groups, expected a divisor of 4 channels", ShapeError);
  CHECK_THROWS_WITH_AS(call({2, 4, 3}, 4, 4, 0),
                       "group_normalised: 0 groups, expected a divisor of 4 channels", ShapeError);
}

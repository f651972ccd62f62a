// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/ops/concat.h"
#include "satsurf/ops/softmax.h"
#include "satsurf/ops/softmax_kernels.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "tests/gradcheck.h"
#include "tests/isa_variants.h"

using namespace satsurf;
using test::gradcheck;
using test::normal;

namespace {

BasicTensor<double> softmax_ref(const BasicTensor<double>& x) {
  const Index B = x.dim(0), D = x.dim(1), P = x.dim(2) * x.dim(3);
  BasicTensor<double> y(x.shape());
  for (Index b = 0; b < B; ++b)
    for (Index i = 0; i < P; ++i) {
      double top = -1e300, total = 0;
      for (Index d = 0; d < D; ++d) top = std::max(top, x[(b * D + d) * P + i]);
      for (Index d = 0; d < D; ++d) total += std::exp(x[(b * D + d) * P + i] - top);
      for (Index d = 0; d < D; ++d)
        y[(b * D + d) * P + i] = std::exp(x[(b * D + d) * P + i] - top) / total;
    }
  return y;
}

template <class T>
SoftmaxGradient<T> gradient_of(const BasicTensor<T>& p, const BasicTensor<T>& g,
                               BasicTensor<T>& d) {
  SoftmaxGradient<T> of;
  of.p = p.data();
  of.g = g.data();
  of.d = d.data();
  return of;
}

/// Which results of height_distribution an objective uses.
struct Uses {
  bool probability, height, confidence;
};
constexpr Uses kUses[] = {{true, false, false}, {false, true, false}, {false, false, true},
                          {true, true, false},  {true, false, true},  {false, true, true},
                          {true, true, true}};

/// The results in use one after the other, flat.
template <class T>
BasicVar<T> joined(const BasicVar<T>& logits, const BasicTensor<T>& z, Uses uses) {
  const auto [p, h, c] = height_distribution(logits, z);
  std::vector<BasicVar<T>> parts;
  if (uses.probability) parts.push_back(reshape(p, Shape{p.count()}));
  if (uses.height) parts.push_back(reshape(h, Shape{h.count()}));
  if (uses.confidence) parts.push_back(reshape(c, Shape{c.count()}));
  return concat(parts, 0);
}
}  // namespace

TEST_CASE_TEMPLATE("height_distribution agrees with its definition", T, float, double) {
  const double tolerance = std::is_same_v<T, float> ? 2e-6 : 1e-14;
  const Shape shapes[] = {{2, 5, 3, 7}, {1, 1, 2, 3}, {3, 8, 1, 1}, {2, 64, 9, 11}, {2, 6, 29, 37}};
  for (const Shape& shape : shapes)
    for (const double size : {1.0, 40.0, 3000.0}) {
      CAPTURE(shape.str());
      const auto x = normal(shape, 1, size).cast<T>(), z = normal(shape, 2, 10.0).cast<T>();
      const auto want = softmax_ref(x.template cast<double>());
      const auto [p, h, c] = height_distribution(BasicVar<T>(x), z);
      const Index D = shape[1], P = shape[2] * shape[3];
      REQUIRE(h.shape() == Shape{shape[0], shape[2], shape[3]});
      REQUIRE(c.shape() == h.shape());
      for (Index i = 0; i < h.count(); ++i) {
        double height = 0, top = 0;
        for (Index d = 0; d < D; ++d) {
          const Index at = (i / P * D + d) * P + i % P;
          REQUIRE(std::abs(static_cast<double>(p.value()[at]) - want[at]) < tolerance);
          height += want[at] * static_cast<double>(z[at]);
          top = std::max(top, static_cast<double>(p.value()[at]));
        }
        REQUIRE(std::abs(static_cast<double>(h.value()[i]) - height) < 100 * tolerance);
        REQUIRE(static_cast<double>(c.value()[i]) == top);
      }
    }
}

TEST_CASE_TEMPLATE("softmax kernels of every instruction set", T, float, double) {
  const double tolerance = std::is_same_v<T, float> ? 1e-6 : 1e-13;
  const Index D = 5, stride = 80;
  const auto x = normal({D, stride}, 2).cast<T>(), g = normal({D, stride}, 3).cast<T>();
  for (const auto& k : test::kernel_variants<SoftmaxKernels<T>>())
    for (const Index n : {1, 2, 5, 8, 17, 63, 64}) {
      CAPTURE(k.name);
      CAPTURE(n);
      const T guard = T(9);
      BasicTensor<T> p({D, stride}, guard), d({D, stride}, guard), alone({D, stride}, guard),
          tile({D + 3, kSoftmaxRow});
      k.forward(D, stride, n, x.data(), nullptr, p.data(), nullptr, nullptr, tile.data());
      k.backward(D, stride, n, gradient_of(p, g, d), tile.data());
      auto stored = gradient_of(p, g, alone);
      stored.accumulate = false;
      k.backward(D, stride, n, stored, tile.data());
      const auto want = softmax_ref(x.template cast<double>().reshaped({1, D, 1, stride}));
      for (Index i = 0; i < stride; ++i) {
        double mean = 0;
        for (Index h = 0; h < D; ++h)
          mean += want[h * stride + i] * static_cast<double>(g[h * stride + i]);
        for (Index h = 0; h < D; ++h) {
          const Index at = h * stride + i;
          if (i >= n) {
            CHECK(p[at] == guard);
            CHECK(d[at] == guard);
            CHECK(alone[at] == guard);
          } else {
            CHECK(std::abs(static_cast<double>(p[at]) - want[at]) < tolerance);
            CHECK(std::abs(static_cast<double>(d[at]) - 9 -
                           want[at] * (static_cast<double>(g[at]) - mean)) < 10 * tolerance);
            CHECK(std::abs(static_cast<double>(alone[at]) -
                           want[at] * (static_cast<double>(g[at]) - mean)) < 10 * tolerance);
          }
        }
      }
    }
}

TEST_CASE_TEMPLATE("height distribution kernels of every instruction set", T, float, double) {
  const double tolerance = std::is_same_v<T, float> ? 1e-6 : 1e-13;
  for (const Index D : {1, 2, 5, 8, 11}) {
    const Index stride = 80;
    auto x = normal({D, stride}, 2).cast<T>();
    const auto g = normal({D, stride}, 3).cast<T>(), z = normal({D, stride}, 4).cast<T>(),
               gh = normal({stride}, 5).cast<T>(), gc = normal({stride}, 6).cast<T>();
    if (D > 3) x[3 * stride] = x[stride] = T(4);  // pixel 0: of equal maxima the first counts
    for (const auto& k : test::kernel_variants<SoftmaxKernels<T>>())
      for (const Index n : {1, 2, 7, 16, 17, 80})
        for (const bool with_g : {false, true}) {
          CAPTURE(k.name);
          CAPTURE(D);
          CAPTURE(n);
          CAPTURE(with_g);
          const T guard = T(9);
          BasicTensor<T> p({D, stride}, guard), d({D, stride}, guard), h({stride}, guard),
              c({stride}, guard), tile({D + 3, kSoftmaxRow});
          k.forward(D, stride, n, x.data(), z.data(), p.data(), h.data(), c.data(), tile.data());
          auto of = gradient_of(p, g, d);
          if (!with_g) of.g = nullptr;
          of.z = z.data();
          of.height = h.data();
          of.confidence = c.data();
          of.g_height = gh.data();
          of.g_confidence = gc.data();
          k.backward(D, stride, n, of, tile.data());
          const auto want = softmax_ref(x.template cast<double>().reshaped({1, D, 1, stride}));
          for (Index i = 0; i < stride; ++i) {
            if (i >= n) {
              CHECK(h[i] == guard);
              CHECK(c[i] == guard);
              for (Index e = 0; e < D; ++e) CHECK(p[e * stride + i] == guard);
              for (Index e = 0; e < D; ++e) CHECK(d[e * stride + i] == guard);
              continue;
            }
            double height = 0, mean = 0;
            Index top = 0;
            for (Index e = 0; e < D; ++e) {
              height += want[e * stride + i] * static_cast<double>(z[e * stride + i]);
              if (x[e * stride + i] > x[top * stride + i]) top = e;
            }
            const auto slope = [&](Index e) {
              const Index at = e * stride + i;
              return static_cast<double>(with_g ? g[at] : T(0)) +
                     static_cast<double>(gh[i]) * static_cast<double>(z[at]) +
                     (e == top ? static_cast<double>(gc[i]) : 0.0);
            };
            for (Index e = 0; e < D; ++e) mean += want[e * stride + i] * slope(e);
            CHECK(std::abs(static_cast<double>(h[i]) - height) < 4 * tolerance);
            CHECK(c[i] == p[top * stride + i]);
            for (Index e = 0; e < D; ++e) {
              const Index at = e * stride + i;
              CHECK(std::abs(static_cast<double>(p[at]) - want[at]) < tolerance);
              CHECK(std::abs(static_cast<double>(d[at]) - 9 - want[at] * (slope(e) - mean)) <
                    20 * tolerance);
            }
          }
        }
  }
}

TEST_CASE("height_distribution adds to a gradient that is there, and lives without its tape") {
  const auto z = normal({2, 3, 4, 5}, 2);
  const BasicVar<double> x(normal({2, 3, 4, 5}, 1), true);
  const auto once = [&] {
    joined(x, z, {true, true, true}).backward(BasicTensor<double>({2 * 5 * 20}, 0.5));
  };
  once();
  const auto first = x.grad().clone();
  once();
  for (Index i = 0; i < x.count(); ++i) CHECK(x.grad()[i] == doctest::Approx(2 * first[i]));

  const auto plain = height_distribution(x.detach(), z);
  CHECK_FALSE(plain.probability.wants_grad());
  CHECK_FALSE(plain.height.wants_grad());
  CHECK_FALSE(plain.confidence.wants_grad());

  const BasicVar<double> y(x.value(), true);
  auto kept = height_distribution(y, z);
  const auto confidence = kept.confidence;
  kept = {};  // the other two may be gone
  confidence.backward(BasicTensor<double>(confidence.shape(), 1.0));
  CHECK_FALSE(y.grad().empty());
}

TEST_CASE("height and confidence by hand") {
  const double rare = std::log(2.0);  // probabilities 2/5, 2/5 and 1/5; then 1/4, 1/2 and 1/4
  const BasicVar<double> x(BasicTensor<double>::from({1, 3, 1, 2}, {0, 0, 0, rare, -rare, 0}),
                           true);
  const auto z = BasicTensor<double>::from({1, 3, 1, 2}, {10, 100, 20, 200, 30, 300});
  const auto [p, h, c] = height_distribution(x, z);
  CHECK(p.value()[0] == doctest::Approx(0.4));
  CHECK(h.value()[0] == doctest::Approx(18));
  CHECK(h.value()[1] == doctest::Approx(200));
  CHECK(c.value()[0] == doctest::Approx(0.4));
  CHECK(c.value()[1] == doctest::Approx(0.5));
  c.backward(BasicTensor<double>::from({1, 1, 2}, {1, 1}));
  // p_d ([d is the maximum] - p_max), of two equal maxima the first
  const double want[] = {0.24, -0.125, -0.16, 0.25, -0.08, -0.125};
  for (Index i = 0; i < 6; ++i) CHECK(x.grad()[i] == doctest::Approx(want[i]));
}

TEST_CASE("softmax gradients") {
  using V = test::DoubleVars;
  const auto x = normal({2, 5, 3, 7}, 4), z = normal({2, 5, 3, 7}, 5, 30.0);
  for (const Uses& uses : kUses) {
    CAPTURE(uses.probability);
    CAPTURE(uses.height);
    CAPTURE(uses.confidence);
    CHECK(gradcheck([&](const V& v) { return joined(v[0], z, uses); }, {x}));
  }
  const auto wide = normal({2, 3, 1, 67}, 7, 30.0);
  CHECK(gradcheck(
      [&](const V& v) {
        return joined(v[0], wide, {true, true, true});
      },
      {normal({2, 3, 1, 67}, 6)}));
}

TEST_CASE("softmax gives the same bits for any number of threads") {
  const auto x = normal({2, 9, 37, 41}, 7).cast<float>();
  const auto run = [&](int threads) {
    set_threads(threads);
    const Var b(x, true);
    const Var all = joined(b, x, {true, true, true});
    all.backward(all.value());
    set_threads(0);
    return std::vector<Tensor>{all.value(), b.grad()};
  };
  const auto one = run(1), two = run(2);
  for (std::size_t k = 0; k < one.size(); ++k)
    for (Index i = 0; i < one[k].count(); ++i) REQUIRE(one[k][i] == two[k][i]);
}

TEST_CASE("softmax refuses") {
  const BasicVar<double> x(BasicTensor<double>({2, 3, 4, 5}));
  CHECK_THROWS_WITH_AS(
      height_distribution(x, BasicTensor<double>({2, 3, 5, 5})),
      "height_distribution: heights has shape [2,3,5,5], expected [B D H W] with B=2 from logits, "
      "D=3 from logits, H=4 from logits, W=5 from logits",
      ShapeError);
  CHECK_THROWS_WITH_AS(
      height_distribution(BasicVar<double>(BasicTensor<double>({2, 0, 4, 5})),
                          BasicTensor<double>({2, 0, 4, 5})),
      "height_distribution: logits has shape [2,0,4,5], expected at least one hypothesis",
      ShapeError);
}

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/ops/concat.h"
#include "satsurf/ops/softmax.h"

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

/// The parts in use one after the other, flat.
template <class T>
BasicVar<T> joined(const BasicVar<T>& p, const BasicVar<T>& h, const BasicVar<T>& c, Uses uses) {
  std::vector<BasicVar<T>> parts;
  if (uses.probability) parts.push_back(reshape(p, Shape{p.count()}));
  if (uses.height) parts.push_back(reshape(h, Shape{h.count()}));
  if (uses.confidence) parts.push_back(reshape(c, Shape{c.count()}));
  return concat(parts, 0);
}
template <class T>
BasicVar<T> fused(const BasicVar<T>& logits, const BasicTensor<T>& z, Uses uses) {
  const auto [p, h, c] = height_distribution(logits, z);
  return joined(p, h, c, uses);
}
template <class T>
BasicVar<T> one_by_one(const BasicVar<T>& logits, const BasicTensor<T>& z, Uses uses) {
  const auto p = softmax_hypotheses(logits);
  return joined(p, expected_height(p, z), max_probability(p), uses);
}

}  // namespace

TEST_CASE("softmax_hypotheses agrees with its definition") {
  const Shape shapes[] = {{2, 5, 3, 7}, {1, 1, 2, 3}, {3, 8, 1, 1}, {2, 64, 9, 11}, {1, 3, 31, 33}};
  for (const Shape& shape : shapes)
    for (const double size : {1.0, 40.0, 3000.0}) {
      CAPTURE(shape.str());
      const auto x = normal(shape, 1, size);
      const auto want = softmax_ref(x);
      const auto y = softmax_hypotheses(BasicVar<double>(x)).value();
      const auto xf = x.cast<float>();
      const auto f = softmax_hypotheses(Var(xf)).value();
      const auto want_f = softmax_ref(xf.cast<double>());
      for (Index i = 0; i < x.count(); ++i) {
        REQUIRE(std::abs(y[i] - want[i]) < 1e-14);
        REQUIRE(std::abs(static_cast<double>(f[i]) - want_f[i]) < 2e-6);
      }
    }
}

TEST_CASE_TEMPLATE("softmax kernels of every instruction set", T, float, double) {
  const double tolerance = std::is_same_v<T, float> ? 1e-6 : 1e-13;
  const Index D = 5, stride = 80;
  const auto x = normal({D, stride}, 2).cast<T>(), g = normal({D, stride}, 3).cast<T>();
  for (const auto& k : test::softmax_variants<T>())
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
    for (const auto& k : test::softmax_variants<T>())
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
          BasicTensor<T> dm({D, stride}, guard), most({stride}, guard), first({stride}, guard),
              dm_alone({D, stride}, guard);
          k.maximum(D, stride, n, p.data(), most.data(), first.data());
          k.max_backward(D, stride, n, first.data(), gc.data(), true, dm.data());
          k.max_backward(D, stride, n, first.data(), gc.data(), false, dm_alone.data());
          const auto want = softmax_ref(x.template cast<double>().reshaped({1, D, 1, stride}));
          for (Index i = 0; i < stride; ++i) {
            if (i >= n) {
              for (Index e = 0; e < D; ++e) {
                CHECK(dm[e * stride + i] == guard);
                CHECK(dm_alone[e * stride + i] == guard);
              }
              CHECK(most[i] == guard);
              CHECK(first[i] == guard);
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
            for (Index e = 0; e < D; ++e) {
              CHECK(dm[e * stride + i] == (e == top ? guard + gc[i] : guard));
              CHECK(dm_alone[e * stride + i] == (e == top ? gc[i] : T(0)));
            }
            CHECK(most[i] == p[top * stride + i]);
            CHECK(first[i] == static_cast<T>(top));
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

TEST_CASE_TEMPLATE("height_distribution is the three ops in one", T, float, double) {
  const double tolerance = std::is_same_v<T, float> ? 1e-5 : 1e-12;
  const Shape shapes[] = {{2, 5, 3, 7}, {1, 1, 2, 3}, {3, 8, 1, 1}, {2, 6, 29, 37}};
  for (const Shape& shape : shapes)
    for (const Uses& uses : kUses) {
      CAPTURE(shape.str());
      CAPTURE(uses.probability);
      CAPTURE(uses.height);
      CAPTURE(uses.confidence);
      const BasicVar<T> x(normal(shape, 1).cast<T>(), true), y(x.value().clone(), true);
      const auto z = normal(shape, 2, 10.0).cast<T>();
      const auto a = fused(x, z, uses), b = one_by_one(y, z, uses);
      const auto g = normal(a.shape(), 3).template cast<T>();
      a.backward(g);
      b.backward(g);
      for (Index i = 0; i < a.count(); ++i)
        REQUIRE(std::abs(static_cast<double>(a.value()[i] - b.value()[i])) < tolerance);
      for (Index i = 0; i < x.count(); ++i)
        REQUIRE(std::abs(static_cast<double>(x.grad()[i] - y.grad()[i])) < 10 * tolerance);
    }
}

TEST_CASE("height_distribution adds to a gradient that is there, and lives without its tape") {
  const auto z = normal({2, 3, 4, 5}, 2);
  const BasicVar<double> x(normal({2, 3, 4, 5}, 1), true);
  const auto once = [&] {
    fused(x, z, {true, true, true}).backward(BasicTensor<double>({2 * 5 * 20}, 0.5));
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

TEST_CASE("expected height and confidence by hand") {
  const BasicVar<double> p(BasicTensor<double>::from({1, 3, 1, 2}, {0.2, 0.5, 0.3, 0.5, 0.5, 0.0}),
                           true);
  const auto z = BasicTensor<double>::from({1, 3, 1, 2}, {10, 100, 20, 200, 30, 300});
  const auto h = expected_height(p, z), c = max_probability(p);
  CHECK(h.shape() == Shape{1, 1, 2});
  CHECK(h.value()[0] == doctest::Approx(23));
  CHECK(h.value()[1] == doctest::Approx(150));
  CHECK(c.value()[0] == 0.5);
  CHECK(c.value()[1] == 0.5);
  c.backward(BasicTensor<double>::from({1, 1, 2}, {3, 4}));
  const double want[] = {0, 4, 0, 0, 3, 0};  // the first of two equal maxima
  for (Index i = 0; i < 6; ++i) CHECK(p.grad()[i] == want[i]);
}

TEST_CASE("softmax gradients") {
  using V = test::DoubleVars;
  const auto x = normal({2, 5, 3, 7}, 4), z = normal({2, 5, 3, 7}, 5, 30.0);
  CHECK(gradcheck([](const V& v) { return softmax_hypotheses(v[0]); }, {x}));
  CHECK(gradcheck([](const V& v) { return softmax_hypotheses(v[0]); }, {normal({2, 3, 1, 67}, 6)}));
  CHECK(gradcheck([&](const V& v) { return expected_height(v[0], z); }, {x}));
  CHECK(gradcheck([](const V& v) { return max_probability(v[0]); }, {x}));
  CHECK(gradcheck([&](const V& v) { return expected_height(softmax_hypotheses(v[0]), z); }, {x}));
  for (const Uses& uses : kUses) {
    CAPTURE(uses.probability);
    CAPTURE(uses.height);
    CAPTURE(uses.confidence);
    CHECK(gradcheck([&](const V& v) { return fused(v[0], z, uses); }, {x}));
  }
  const auto wide = normal({2, 3, 1, 67}, 7, 30.0);
  CHECK(gradcheck(
      [&](const V& v) {
        return fused(v[0], wide, {true, true, true});
      },
      {normal({2, 3, 1, 67}, 6)}));
}

TEST_CASE("softmax gives the same bits for any number of threads") {
  const auto x = normal({2, 9, 37, 41}, 7).cast<float>();
  const auto run = [&](int threads) {
    set_threads(threads);
    const Var a(x, true);
    const Var p = softmax_hypotheses(a), h = expected_height(p, x), c = max_probability(p);
    h.backward(Tensor(h.shape(), 0.7f));
    const Tensor first = a.grad().clone();
    const Var q = softmax_hypotheses(a), m = max_probability(q);
    m.backward(Tensor(m.shape(), 0.2f));
    const Var b(x, true);
    const Var all = fused(b, x, {true, true, true});
    all.backward(all.value());
    set_threads(0);
    return std::vector<Tensor>{p.value(), h.value(),   c.value(), first,
                               a.grad(),  all.value(), b.grad()};
  };
  const auto one = run(1), two = run(2);
  for (std::size_t k = 0; k < one.size(); ++k)
    for (Index i = 0; i < one[k].count(); ++i) REQUIRE(one[k][i] == two[k][i]);
}

TEST_CASE("softmax refuses") {
  const BasicVar<double> x(BasicTensor<double>({2, 3, 4, 5}));
  CHECK_THROWS_WITH_AS(softmax_hypotheses(BasicVar<double>(BasicTensor<double>({2, 3}))),
                       "softmax_hypotheses: logits has shape [2,3], expected [B D H W]",
                       ShapeError);
  CHECK_THROWS_WITH_AS(
      expected_height(x, BasicTensor<double>({2, 3, 4, 6})),
      "expected_height: heights has shape [2,3,4,6], expected [B D H W] with B=2 from probability, "
      "D=3 from probability, H=4 from probability, W=5 from probability",
      ShapeError);
  CHECK_THROWS_WITH_AS(
      max_probability(BasicVar<double>(BasicTensor<double>({2, 0, 4, 5}))),
      "max_probability: probability has shape [2,0,4,5], expected at least one hypothesis",
      ShapeError);
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

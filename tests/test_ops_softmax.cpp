// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
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
  for (const auto& k : test::pointwise_variants<T>())
    for (const Index n : {1, 2, 5, 8, 17, 63, 64}) {
      CAPTURE(k.name);
      CAPTURE(n);
      const T guard = T(9);
      BasicTensor<T> p({D, stride}, guard), d({D, stride}, guard), tile({D, kSoftmaxTile});
      k.softmax(D, stride, n, x.data(), p.data(), tile.data());
      k.softmax_backward(D, stride, n, p.data(), g.data(), d.data(), tile.data());
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
          } else {
            CHECK(std::abs(static_cast<double>(p[at]) - want[at]) < tolerance);
            CHECK(std::abs(static_cast<double>(d[at]) - 9 -
                           want[at] * (static_cast<double>(g[at]) - mean)) < 10 * tolerance);
          }
        }
      }
    }
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
    set_threads(0);
    return std::vector<Tensor>{p.value(), h.value(), c.value(), first, a.grad()};
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
}

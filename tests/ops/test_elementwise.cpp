// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/block_pool.h"
#include "satsurf/core/parallel.h"
#include "satsurf/ops/concat.h"
#include "satsurf/ops/elementwise.h"
#include "satsurf/ops/pointwise_kernels.h"

#include <cmath>
#include <limits>

#include "tests/gradcheck.h"
#include "tests/isa_variants.h"

using namespace satsurf;
using test::away_from;
using test::gradcheck;
using test::normal;

namespace {

double phi_cdf(double x) { return 0.5 * std::erfc(-x / std::sqrt(2.0)); }

/// Values from -20 to 20, dense around 0, and the extremes.
template <class T>
BasicTensor<T> sweep_of_values() {
  BasicTensor<T> x({1007});
  for (Index i = 0; i < 1001; ++i) {
    const double t = static_cast<double>(i - 500) / 500;
    x[i] = static_cast<T>(20 * t * std::abs(t));
  }
  const T extremes[] = {T(-1e30), T(1e30), std::numeric_limits<T>::denorm_min(),
                        T(-0.0),  T(-100), T(100)};
  for (Index i = 0; i < 6; ++i) x[1001 + i] = extremes[i];
  return x;
}

}  // namespace

TEST_CASE("elementwise values") {
  const BasicVar<double> a(BasicTensor<double>::from({2, 3}, {1, -2, 3, -4, 5, -6}));
  const BasicVar<double> b(BasicTensor<double>::from({2, 3}, {10, 20, 30, 40, 50, 60}));
  const double sums[] = {11, 18, 33, 36, 55, 54}, differences[] = {-9, -22, -27, -44, -45, -66};
  const double products[] = {10, -40, 90, -160, 250, -360}, lines[] = {5, -1, 9, -5, 13, -9};
  for (Index i = 0; i < 6; ++i) {
    CHECK((a + b).value()[i] == sums[i]);
    CHECK((a - b).value()[i] == differences[i]);
    CHECK((a * b).value()[i] == products[i]);
    CHECK(affine(a, 2.0, 3.0).value()[i] == lines[i]);
    CHECK(relu(a).value()[i] == std::max(0.0, a.value()[i]));
  }
}

TEST_CASE_TEMPLATE("smooth functions agree with the standard library", T, float, double) {
  const auto x = sweep_of_values<T>();
  const BasicVar<T> v(x);
  const auto s = sigmoid(v).value(), g = gelu(v).value();
  const double tolerance = std::is_same_v<T, float> ? 2e-7 : 1e-13;
  for (Index i = 0; i < x.count(); ++i) {
    const double xi = static_cast<double>(x[i]);
    CAPTURE(xi);
    const double logistic = xi > 0 ? 1 / (1 + std::exp(-xi)) : std::exp(xi) / (1 + std::exp(xi));
    CHECK(std::abs(static_cast<double>(s[i]) - logistic) <= tolerance);
    const double exact = xi < -50 ? 0.0 : xi * phi_cdf(xi);
    CHECK(std::abs(static_cast<double>(g[i]) - exact) <=
          tolerance * std::max(1.0, std::abs(exact)));
  }
}

TEST_CASE_TEMPLATE("pointwise kernels of every instruction set", T, float, double) {
  const auto all = sweep_of_values<T>();
  const double tolerance = std::is_same_v<T, float> ? 3e-7 : 1e-13;
  for (const auto& k : test::kernel_variants<PointwiseKernels<T>>())
    for (const Index n : {1, 2, 3, 7, 15, 16, 17, 31, 1007}) {
      CAPTURE(k.name);
      CAPTURE(n);
      const T* x = all.data() + (all.count() - n);
      const T guard = T(12345);
      BasicTensor<T> y({n + 1}, guard), s({n + 1}, guard), dg({n + 1}, guard), dr({n + 1}, guard);
      const BasicTensor<T> g({n}, T(0.5));
      k.gelu(n, x, y.data());
      k.logistic(n, x, s.data());
      dg.fill(T(1));
      dr.fill(T(1));
      k.gelu_backward(n, x, g.data(), true, dg.data());
      k.relu_backward(n, x, g.data(), true, dr.data());
      BasicTensor<T> first({n + 1}, guard);  // stored, not added
      const auto stores = [&](const auto& backward, const T* v, const BasicTensor<T>& added) {
        first.fill(guard);
        backward(n, v, g.data(), false, first.data());
        for (Index i = 0; i < n; ++i)
          CHECK(std::abs(static_cast<double>(first[i] + T(1) - added[i])) <= tolerance);
        CHECK(first[n] == guard);
      };
      stores(k.gelu_backward, x, dg);
      stores(k.relu_backward, x, dr);
      for (Index i = 0; i < n; ++i) {
        const double xi = static_cast<double>(x[i]), cdf = phi_cdf(xi);
        CAPTURE(xi);
        const double value = xi < -50 ? 0.0 : xi * cdf;
        const double slope =
            cdf + (std::abs(xi) > 50 ? 0.0 : xi * std::exp(-xi * xi / 2) / std::sqrt(2 * M_PI));
        CHECK(std::abs(static_cast<double>(y[i]) - value) <=
              tolerance * std::max(1.0, std::abs(value)));
        CHECK(std::abs(static_cast<double>(dg[i]) - (1 + 0.5 * slope)) <= tolerance);
        CHECK(std::abs(static_cast<double>(s[i]) - 1 / (1 + std::exp(-xi))) <= tolerance);
        CHECK(dr[i] == (x[i] > 0 ? T(1.5) : T(1)));
      }
      CHECK(y[n] == guard);
      CHECK(s[n] == guard);
      CHECK(dg[n] == T(1));
      CHECK(dr[n] == T(1));
    }
}

TEST_CASE("elementwise gradients") {
  const auto a = normal({2, 3, 5}, 1), b = normal({2, 3, 5}, 2);
  const auto off = away_from(normal({2, 3, 5}, 3), 0, 0.01);
  using V = test::DoubleVars;
  CHECK(gradcheck([](const V& v) { return add(v[0], v[1]); }, {a, b}));
  CHECK(gradcheck([](const V& v) { return sub(v[0], v[1]); }, {a, b}));
  CHECK(gradcheck([](const V& v) { return mul(v[0], v[1]); }, {a, b}));
  CHECK(gradcheck([](const V& v) { return mul(v[0], v[0]); }, {a}));
  CHECK(gradcheck([](const V& v) { return add(v[0], v[0]); }, {a}));
  CHECK(gradcheck([](const V& v) { return sub(affine(v[0], 3.0, 0.0), v[0]); }, {a}));
  CHECK(gradcheck([](const V& v) { return affine(v[0], -1.7, 0.3); }, {a}));
  CHECK(gradcheck([](const V& v) { return relu(v[0]); }, {off}));
  CHECK(gradcheck([](const V& v) { return gelu(v[0]); }, {a}));
  CHECK(gradcheck([](const V& v) { return sigmoid(v[0]); }, {a}));
}

TEST_CASE("the gradient of relu at 0 is 0") {
  const BasicVar<double> x(BasicTensor<double>::from({3}, {0.0, -0.0, 1.0}), true);
  relu(x).backward(BasicTensor<double>({3}, 1.0));
  CHECK(x.grad()[0] == 0);
  CHECK(x.grad()[1] == 0);
  CHECK(x.grad()[2] == 1);
}

TEST_CASE_TEMPLATE("gelu at the ends", T, float, double) {
  const T nan = std::numeric_limits<T>::quiet_NaN();
  for (const auto& k : test::kernel_variants<PointwiseKernels<T>>()) {
    CAPTURE(k.name);
    const T x[] = {nan, T(0), T(-0.0), T(-50), T(50)}, g[] = {1, 1, 1, 1, 1};
    T y[5], d[5];
    k.gelu(5, x, y);
    k.gelu_backward(5, x, g, false, d);
    CHECK(y[0] != y[0]);
    CHECK(d[0] != d[0]);
    CHECK(y[1] == 0);
    CHECK(y[2] == 0);
    CHECK(d[1] == doctest::Approx(0.5).epsilon(2e-7));
    CHECK(y[3] == 0);
    CHECK(d[3] == 0);
    CHECK(y[4] == 50);
    CHECK(d[4] == 1);
  }
}

TEST_CASE("NaN passes through relu") {
  const Var x(Tensor({3}, std::numeric_limits<float>::quiet_NaN()));
  for (Index i = 0; i < 3; ++i)
    CHECK_MESSAGE(relu(x).value()[i] != relu(x).value()[i], "a NaN must stay visible");
}

TEST_CASE("elementwise ops give the same bits for any number of threads") {
  const auto x = normal({3, 50021}, 4).cast<float>(), y = normal({3, 50021}, 5).cast<float>();
  const auto run = [&](int threads) {
    set_threads(threads);
    const Var a(x, true), b(y, true);
    const Var out = gelu(a) * sigmoid(b) + relu(a - b);
    out.backward(x);
    set_threads(0);
    return std::vector<Tensor>{out.value(), a.grad(), b.grad()};
  };
  const auto one = run(1), two = run(2);
  for (std::size_t k = 0; k < one.size(); ++k)
    for (Index i = 0; i < one[k].count(); ++i) REQUIRE(one[k][i] == two[k][i]);
}

TEST_CASE("elementwise ops refuse unequal shapes") {
  const BasicVar<double> a(BasicTensor<double>({2, 3})), b(BasicTensor<double>({3, 2}));
  CHECK_THROWS_WITH_AS(add(a, b), "add: b has shape [3,2], expected [2,3] from a", ShapeError);
  CHECK_THROWS_WITH_AS(sub(a, b), "sub: b has shape [3,2], expected [2,3] from a", ShapeError);
  CHECK_THROWS_WITH_AS(mul(a, b), "mul: b has shape [3,2], expected [2,3] from a", ShapeError);
}

TEST_CASE("without a tape the last copy's buffer takes the result, and nobody else's") {
  const Tensor a = Tensor::from({2, 2}, {1, 2, 3, 4}), b = Tensor::from({2, 2}, {10, 20, 30, 40});
  const auto fresh = [](const Tensor& t) { return Var(t.clone()); };
  {
    const NoGrad no_grad;
    Var left = fresh(a);
    const float* const buffer = left.value().data();
    const Var sum = add(std::move(left), Var(b));
    CHECK(sum.value().data() == buffer);
    CHECK(sum.value()[3] == 44);

    const Var kept = fresh(a);  // another copy of the Var
    CHECK(add(kept, Var(b)).value().data() != kept.value().data());
    const Tensor seen = a.clone();  // another tensor on the buffer
    CHECK(add(Var(seen), Var(seen)).value().data() != seen.data());
    CHECK(seen[3] == 4);
    const Var shaped = reshape(kept, Shape{4});
    CHECK((kept + reshape(kept, Shape{2, 2})).value()[3] == 8);
    CHECK(kept.value()[3] == 4);
    Var leaf(a.clone(), true);  // a parameter
    const float* const parameter = leaf.value().data();
    CHECK(add(std::move(leaf), Var(b)).value().data() != parameter);
  }
  Var left = fresh(a);
  const float* const buffer = left.value().data();
  CHECK(add(std::move(left), Var(b)).value().data() != buffer);  // a tape might read it again
}

TEST_CASE("add never holds two results") {
  const Index n = 1 << 18;
  const Var a(Tensor({n}, 1.f)), b(Tensor({n}, 2.f));
  reset_peak_tensor_bytes();
  const std::size_t before = tensor_bytes();
  const Var sum = add(a, b);
  CHECK(peak_tensor_bytes() == before + static_cast<std::size_t>(n) * sizeof(float));
  CHECK(sum.value()[n - 1] == 3);
  const NoGrad no_grad;
  Var right(Tensor({n}, 5.f));
  const float* const buffer = right.value().data();
  const Var last = add(a, std::move(right));
  CHECK(last.value().data() == buffer);
  CHECK(last.value()[0] == 6);
}

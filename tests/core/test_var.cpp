// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/block_pool.h"
#include "satsurf/core/error.h"
#include "satsurf/core/var.h"

#include <cmath>
#include <limits>
#include <thread>

#include "tests/gradcheck.h"

using namespace satsurf;

namespace {

using V = BasicVar<double>;
using T = BasicTensor<double>;

/// a * b + c, element by element; c may be empty.
V muladd(const V& a, const V& b, const V& c = {}) {
  const Index n = a.count();
  T out = T::uninitialised(a.shape());
  for (Index i = 0; i < n; ++i)
    out[i] = a.value()[i] * b.value()[i] + (c.empty() ? 0 : c.value()[i]);
  return V::record("muladd", out, {a, b, c}, [n](Node<double>& node) {
    const double* g = node.grad.data();
    if (double* da = node.grad_in(0))
      for (Index i = 0; i < n; ++i) da[i] += g[i] * node.in(1)[i];
    if (double* db = node.grad_in(1))
      for (Index i = 0; i < n; ++i) db[i] += g[i] * node.in(0)[i];
    if (double* dc = node.grad_in(2))
      for (Index i = 0; i < n; ++i) dc[i] += g[i];
  });
}

V successor(const V& a) {
  T out = a.value().clone();
  out[0] += 1;
  return V::record("successor", out, {a}, [](Node<double>& n) {
    if (double* da = n.grad_in(0)) da[0] += n.grad[0];
  });
}

V leaf(double value, bool wants_grad = true) { return V(T({1}, value), wants_grad); }

}  // namespace

TEST_CASE("var: gradients of an op with an optional input") {
  const auto a = test::normal({3, 2}, 1), b = test::normal({3, 2}, 2), c = test::normal({3, 2}, 3);
  CHECK(test::gradcheck([](auto& v) { return muladd(v[0], v[1], v[2]); }, {a, b, c}));
  CHECK(test::gradcheck([](auto& v) { return muladd(v[0], v[1]); }, {a, b}));
}

TEST_CASE("var: chain, diamond and one input used twice") {
  const V x = leaf(3);
  SUBCASE("chain") {
    successor(successor(muladd(x, leaf(2, false)))).backward();
    CHECK(x.grad()[0] == 2);
  }
  SUBCASE("diamond: both branches arrive before the fork runs") {
    const V fork = muladd(x, x);                 // x^2
    const V left = muladd(fork, fork);           // x^4
    const V right = successor(successor(fork));  // x^2 + 2
    muladd(left, right).backward();              // x^6 + 2 x^4
    CHECK(x.grad()[0] == 6 * std::pow(3, 5) + 8 * std::pow(3, 3));
  }
  SUBCASE("the same value as two inputs") {
    muladd(x, x, x).backward();  // x^2 + x
    CHECK(x.grad()[0] == 7);
  }
}

TEST_CASE("var: leaves accumulate over backward passes until cleared") {
  V x = leaf(3);
  muladd(x, x).backward();
  muladd(x, x).backward();
  CHECK(x.grad()[0] == 12);
  x.clear_grad();
  CHECK(x.grad().empty());
}

TEST_CASE("var: nobody pays for gradients nobody wants") {
  const V x = leaf(3, false), y = leaf(2);
  muladd(x, y).backward();
  CHECK(x.grad().empty());
  CHECK(y.grad()[0] == 3);
  CHECK(!muladd(x, x).wants_grad());
  CHECK(!y.detach().wants_grad());
  CHECK(y.detach().value().data() == y.value().data());
  CHECK(!V().wants_grad());
  CHECK_NOTHROW(x.backward());
}

TEST_CASE("var: the seed must fit") {
  const V x(T({2, 3}), true);
  CHECK_THROWS_WITH_AS(
      x.backward(), "backward: value has shape [2,3], expected one element or a seed", ShapeError);
  CHECK_THROWS_WITH_AS(x.backward(T({3, 2})), "backward: seed has shape [3,2], expected [2,3]",
                       ShapeError);
  const V y = muladd(x, x);
  x.backward(T({2, 3}, 4.0));
  CHECK(x.grad()[5] == 4);
}

TEST_CASE("var: NoGrad records nothing, in this thread only") {
  const V x = leaf(3);
  CHECK(!NoGrad::active());
  {
    const NoGrad outer;
    const NoGrad inner;
    CHECK(NoGrad::active());
    CHECK(!muladd(x, x).wants_grad());
    bool other = true;
    std::thread([&] { other = NoGrad::active(); }).join();
    CHECK(!other);
  }
  CHECK(!NoGrad::active());
  CHECK(muladd(x, x).wants_grad());
}

TEST_CASE("gradcheck sees a wrong gradient however small all of them are") {
  const auto scaled_mean = [](double slip) {
    return [slip](const std::vector<V>& v) {
      const Index n = v[0].count();
      const double part = 1e-6 / static_cast<double>(n);
      double sum = 0;
      for (Index i = 0; i < n; ++i) sum += part * v[0].value()[i];
      return V::record("scaled_mean", T::scalar(sum), {v[0]}, [n, part, slip](Node<double>& node) {
        if (double* d = node.grad_in(0))
          for (Index i = 0; i < n; ++i) d[i] += node.grad[0] * part * (i == 2 ? 1 + slip : 1);
      });
    };
  };
  const T x = test::normal({40}, 7);
  CHECK(test::gradcheck(scaled_mean(0), {x}));
  const test::GradcheckReport wrong = test::gradcheck(scaled_mean(1e-4), {x});
  CHECK_FALSE(wrong);
  CHECK(wrong.text.starts_with("input 0 element 2: "));
  CHECK_FALSE(test::gradcheck(scaled_mean(-1e-4), {x}));
}

TEST_CASE("var: the first to write a gradient stores it, the others add") {
  // a + 2 b, whose backward notes for which inputs it had to add
  const auto sum = [](const V& a, const V& b, std::vector<bool>& added, Index left_out = 0) {
    T out = a.value().clone();
    for (Index i = 0; i < out.count(); ++i) out[i] += 2 * b.value()[i];
    return V::record("sum", out, {a, b, V()}, [&added, left_out](Node<double>& n) {
      added.clear();
      for (const std::size_t k : {0, 1, 2}) {
        const GradientTarget<double> d = n.grad_out(k);
        if (!d) continue;
        added.push_back(d.accumulate);
        for (Index i = 0; i < n.grad.count() - left_out; ++i)
          d.data[i] = (d.accumulate ? d.data[i] : 0) + (k == 0 ? 1 : 2) * n.grad[i];
      }
    });
  };
  using Added = std::vector<bool>;
  Added added;
  const V x(T({3}, 1.0), true), y(T({3}, 1.0), true), constant(T({3}, 1.0));
  sum(x, y, added).backward(T({3}, 5.0));
  CHECK(added == Added{false, false});
  sum(x, constant, added).backward(T({3}, 5.0));
  CHECK(added == Added{true});
  CHECK(x.grad()[2] == 10);
  CHECK(y.grad()[2] == 10);
  const V z(T({3}, 1.0), true);
  sum(z, z, added).backward(T({3}, 5.0));  // one value as both inputs
  CHECK(added == Added{false, true});
  CHECK(z.grad()[2] == 15);

  const NanGuard guard;
  const V w(T({3}, 1.0), true);
  CHECK_NOTHROW(sum(w, w, added).backward(T({3}, 5.0)));
  const V v(T({3}, 1.0), true);
  CHECK_THROWS_WITH_AS(sum(v, v, added, 1).backward(T({3}, 5.0)),
                       "sum: gradient element 2 of shape [3] is nan, expected finite numbers",
                       Error);
}

TEST_CASE("gradcheck sees a gradient that is stored where it should be added") {
  const auto identity = [](const std::vector<V>& v) {
    return V::record("identity", v[0].value().clone(), {v[0]}, [](Node<double>& n) {
      const GradientTarget<double> d = n.grad_out(0);
      for (Index i = 0; i < n.grad.count(); ++i) d.data[i] = n.grad[i];
    });
  };
  const test::GradcheckReport wrong = test::gradcheck(identity, {test::normal({4}, 7)});
  CHECK_FALSE(wrong);
  CHECK(wrong.text.starts_with("input 0 element 0: a second pass makes "));
}

TEST_CASE("var: NanGuard names the op that broke first") {
  const V x = leaf(std::numeric_limits<double>::max());
  const V broken = muladd(x, x);
  CHECK(std::isinf(broken.value()[0]));  // silent without the guard
  const NanGuard guard;
  CHECK_THROWS_WITH_AS(
      muladd(x, x), "muladd: value element 0 of shape [1] is inf, expected finite numbers", Error);
  const V one = leaf(1);
  const V bad = V::record("bad_backward", one.value().clone(), {one}, [](Node<double>& n) {
    n.grad_in(0)[0] += std::numeric_limits<double>::quiet_NaN();
  });
  CHECK_THROWS_WITH_AS(
      successor(bad).backward(),
      "bad_backward: gradient element 0 of shape [1] is nan, expected finite numbers", Error);
}

TEST_CASE("var: a chain of a million nodes neither recurses nor leaks") {
  const std::size_t before = tensor_bytes();
  constexpr int kNodes = 1'000'000;
  const auto chain = [](const V& x) {
    V y = x;
    for (int i = 0; i < kNodes; ++i)
      y = V::record("identity", y.value(), {y}, [](Node<double>& n) {
        if (double* d = n.grad_in(0)) d[0] += n.grad[0];
      });
    return y;
  };
  const V x = leaf(3);
  SUBCASE("run backwards") {
    chain(x).backward();
    CHECK(x.grad()[0] == 1);
  }
  SUBCASE("dropped without a backward pass") { chain(x); }
  CHECK(tensor_bytes() <= before + 2 * 64);  // x and its gradient
}

TEST_CASE("var: a tape frees what it saved while it runs") {
  const std::size_t before = tensor_bytes();
  const V x(T({1000}, 1.0), true);
  const V y = muladd(muladd(muladd(x, x), x), x);
  CHECK(tensor_bytes() == before + 4 * 8000);
  y.backward(T({1000}, 1.0));
  // x, its gradient, y and its gradient: the two values between are gone although y lives.
  CHECK(tensor_bytes() == before + 4 * 8000);
  CHECK(x.grad()[999] == 4);
  reset_peak_tensor_bytes();
  y.backward(T({1000}, 1.0));  // a tape runs once: nothing is behind y any more
  CHECK(x.grad()[999] == 4);
}

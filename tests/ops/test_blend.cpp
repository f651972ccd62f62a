// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/ops/blend.h"

#include <vector>

#include "tests/gradcheck.h"

using namespace satsurf;
using test::gradcheck;
using test::normal;

TEST_CASE("channel_dot and add_weighted of known values") {
  const BasicVar<double> a(BasicTensor<double>::from({1, 2, 1, 3}, {1, 2, 3, 4, 5, 6})),
      b(BasicTensor<double>::from({1, 2, 1, 3}, {10, 0, -1, 1, 2, 3})),
      w(BasicTensor<double>::from({1, 1, 3}, {1, 0, 0.5}));
  const auto dot = channel_dot(a, b).value();
  CHECK(dot.shape() == Shape{1, 1, 3});
  CHECK(std::vector<double>(dot.values().begin(), dot.values().end()) ==
        std::vector<double>{14, 10, 15});
  const auto sum = add_weighted(a, w, b).value();
  CHECK(std::vector<double>(sum.values().begin(), sum.values().end()) ==
        std::vector<double>{11, 2, 2.5, 5, 5, 7.5});
}

TEST_CASE("channel_dot and add_weighted: gradients, also of one value twice") {
  const auto a = normal({2, 3, 5, 7}, 1), b = normal({2, 3, 5, 7}, 2), w = normal({2, 5, 7}, 3);
  CHECK(gradcheck([](const test::DoubleVars& v) { return channel_dot(v[0], v[1]); }, {a, b}));
  CHECK(gradcheck([](const test::DoubleVars& v) { return channel_dot(v[0], v[0]); }, {a}));
  CHECK(gradcheck([](const test::DoubleVars& v) { return add_weighted(v[0], v[1], v[2]); },
                  {a, w, b}));
  CHECK(
      gradcheck([](const test::DoubleVars& v) { return add_weighted(v[0], v[1], v[0]); }, {a, w}));
}

TEST_CASE("channel_dot and add_weighted give the same bits on one and on two threads") {
  const auto run = [](int threads) {
    set_threads(threads);
    const Var a(normal({2, 5, 67, 71}, 4).cast<float>(), true),
        b(normal({2, 5, 67, 71}, 5).cast<float>(), true);
    const Var out = add_weighted(a, channel_dot(a, b), b);
    out.backward(normal(out.shape(), 6).cast<float>());
    set_threads(0);
    std::vector<float> all;
    for (const Tensor& t : {out.value(), a.grad(), b.grad()})
      all.insert(all.end(), t.values().begin(), t.values().end());
    return all;
  };
  CHECK(run(1) == run(2));
}

TEST_CASE("channel_dot and add_weighted refuse what does not fit") {
  const Var a(Tensor({1, 2, 3, 4})), b(Tensor({1, 2, 3, 5})), w(Tensor({1, 3, 5}));
  CHECK_THROWS_AS(channel_dot(a, b), ShapeError);
  CHECK_THROWS_AS(add_weighted(a, w, a), ShapeError);
}

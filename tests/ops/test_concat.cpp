// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/ops/concat.h"

#include "tests/gradcheck.h"

using namespace satsurf;
using test::gradcheck;
using test::normal;
using V = test::DoubleVars;

TEST_CASE("concat and slice undo each other along every axis") {
  for (Index axis = 0; axis < 4; ++axis) {
    CAPTURE(axis);
    const Shape base{2, 3, 5, 7};
    const BasicVar<double> a(normal(base, 1)), b(normal(base.with(axis, 4), 2)),
        c(normal(base.with(axis, 1), 3));
    const auto joined = concat<double>({a, b, c}, axis);
    const Index first = base[axis];
    REQUIRE(joined.shape() == base.with(axis, first + 5));
    const std::tuple<BasicVar<double>, Index, Index> parts[] = {
        {a, 0, first}, {b, first, first + 4}, {c, first + 4, first + 5}};
    for (const auto& [part, begin, end] : parts) {
      const auto cut = slice(joined, axis, begin, end).value();
      REQUIRE(cut.shape() == part.shape());
      for (Index i = 0; i < cut.count(); ++i) CHECK(cut[i] == part.value()[i]);
    }
  }
}

TEST_CASE("concat by hand") {
  const BasicVar<double> a(BasicTensor<double>::from({2, 1}, {1, 2})),
      b(BasicTensor<double>::from({2, 2}, {3, 4, 5, 6}));
  const auto y = concat<double>({a, b}, 1).value();
  const double want[] = {1, 3, 4, 2, 5, 6};
  for (Index i = 0; i < 6; ++i) CHECK(y[i] == want[i]);
}

TEST_CASE("reshape shares the buffer") {
  const Var x(Tensor({2, 6}, 3.0f));
  const Var y = reshape(x, {3, 4});
  CHECK(y.shape() == Shape{3, 4});
  CHECK(y.value().data() == x.value().data());
}

TEST_CASE("gradients of the ops that move elements") {
  for (Index axis = 0; axis < 3; ++axis) {
    CAPTURE(axis);
    const Shape base{2, 3, 5};
    CHECK(gradcheck(
        [=](const V& v) {
          return concat<double>({v[0], v[1], v[0]}, axis);
        },
        {normal(base, 5), normal(base.with(axis, 4), 6)}));
    CHECK(gradcheck([=](const V& v) { return slice(v[0], axis, 1, 2); }, {normal(base, 7)}));
  }
  CHECK(gradcheck([](const V& v) { return reshape(v[0], {5, 6}); }, {normal({2, 3, 5}, 8)}));
}

TEST_CASE("concat hands a gradient only to the parts that want one") {
  const BasicVar<double> a(normal({2, 3}, 10), true), b(normal({2, 2}, 11));
  const auto y = concat<double>({b, a}, 1);
  y.backward(BasicTensor<double>::from({2, 5}, {1, 2, 3, 4, 5, 6, 7, 8, 9, 10}));
  const double want[] = {3, 4, 5, 8, 9, 10};
  for (Index i = 0; i < 6; ++i) CHECK(a.grad()[i] == want[i]);
  CHECK(b.grad().empty());
}

TEST_CASE("moving elements gives the same bits for any number of threads") {
  const auto x = normal({3, 5, 101, 67}, 12).cast<float>();
  const auto run = [&](int threads) {
    set_threads(threads);
    const Var a(x, true);
    const Var y = concat<float>({slice(a, 1, 1, 4), a}, 1);
    y.backward(Tensor(y.shape(), 0.1f));
    set_threads(0);
    return std::vector<Tensor>{y.value(), a.grad()};
  };
  const auto one = run(1), two = run(2);
  for (std::size_t k = 0; k < one.size(); ++k)
    for (Index i = 0; i < one[k].count(); ++i) REQUIRE(one[k][i] == two[k][i]);
}

TEST_CASE("ops that move elements refuse") {
  const Var a(Tensor({2, 3})), b(Tensor({3, 3})), c(Tensor({2, 3, 1}));
  CHECK_THROWS_WITH_AS(concat<float>({}, 0), "concat: no parts, expected at least one", ShapeError);
  CHECK_THROWS_WITH_AS(
      concat<float>({a, b}, 1),
      "concat: part 1 has shape [3,3], expected [2,3] from part 0 except along axis 1", ShapeError);
  CHECK_THROWS_WITH_AS(
      concat<float>({a, a, c}, 1),
      "concat: part 2 has shape [2,3,1], expected [2,3] from part 0 except along axis 1",
      ShapeError);
  CHECK_THROWS_WITH_AS(concat<float>({a}, 2), "concat: axis 2, expected one of shape [2,3]",
                       ShapeError);
  CHECK_THROWS_WITH_AS(slice(a, -1, 0, 1), "slice: axis -1, expected one of shape [2,3]",
                       ShapeError);
  CHECK_THROWS_WITH_AS(slice(a, 1, 1, 4),
                       "slice: elements 1..4 of axis 1, expected a range within shape [2,3]",
                       ShapeError);
  CHECK_THROWS_WITH_AS(slice(a, 1, 2, 1),
                       "slice: elements 2..1 of axis 1, expected a range within shape [2,3]",
                       ShapeError);
  CHECK_THROWS_WITH_AS(reshape(a, {4, 2}),
                       "reshape: x has shape [2,3], expected as many elements as [4,2]",
                       ShapeError);
}

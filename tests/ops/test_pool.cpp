// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/ops/pool.h"

#include <cmath>
#include <limits>
#include <numeric>
#include <vector>

#include "tests/gradcheck.h"

using namespace satsurf;
using test::gradcheck;

namespace {

/// Distinct values, at least 0.01 apart, in no order: nothing ties, and no step of a difference
/// changes which element is the largest.
BasicTensor<double> distinct(const Shape& shape, std::uint64_t seed) {
  const auto keys = test::normal(shape, seed);
  std::vector<Index> order(static_cast<std::size_t>(keys.count()));
  std::iota(order.begin(), order.end(), Index{0});
  std::sort(order.begin(), order.end(), [&](Index a, Index b) { return keys[a] < keys[b]; });
  BasicTensor<double> t(shape);
  double value = -1;
  for (const Index i : order) t[i] = value += 0.01;
  return t;
}

struct Case {
  Index H, W;
  PoolOptions options;
  Index h, w;
};
const Case kCases[] = {{7, 9, {3, 2, false}, 3, 4}, {8, 10, {3, 2, false}, 3, 4},
                       {8, 10, {3, 2, true}, 4, 5}, {7, 9, {3, 2, true}, 3, 4},
                       {6, 5, {2, 2, false}, 3, 2}, {2, 3, {3, 2, true}, 1, 1},
                       {5, 4, {1, 1, false}, 5, 4}, {9, 11, {2, 5, true}, 2, 3},
                       {6, 8, {2, 5, true}, 2, 2},  {20, 33, {4, 3, true}, 7, 11}};

}  // namespace

TEST_CASE_TEMPLATE("max_pool2d takes the largest of each window", T, float, double) {
  for (const auto& [H, W, options, h, w] : kCases) {
    CAPTURE(H);
    CAPTURE(W);
    const auto x = distinct({2, 3, H, W}, 1).template cast<T>();
    const auto y = max_pool2d(BasicVar<T>(x), options).value();
    REQUIRE(y.shape() == Shape{2, 3, h, w});
    for (Index p = 0; p < 6; ++p)
      for (Index i = 0; i < h; ++i)
        for (Index j = 0; j < w; ++j) {
          T best = -std::numeric_limits<T>::infinity();
          for (Index r = 0; r < H; ++r)
            for (Index c = 0; c < W; ++c)
              if (r >= i * options.stride && r < i * options.stride + options.kernel &&
                  c >= j * options.stride && c < j * options.stride + options.kernel)
                best = std::max(best, x[(p * H + r) * W + c]);
          REQUIRE(y[(p * h + i) * w + j] == best);
        }
  }
}

TEST_CASE("max_pool2d gradient") {
  for (const auto& [H, W, options, h, w] : kCases) {
    CAPTURE(H);
    CAPTURE(W);
    const PoolOptions o = options;
    if (H * W <= 110)
      CHECK(gradcheck([&](auto& v) { return max_pool2d(v[0], o); }, {distinct({2, 3, H, W}, 2)}));
  }
  SUBCASE("the first of equal elements takes all") {
    BasicVar<double> x(BasicTensor<double>({1, 1, 2, 3}, 4.0), true);
    max_pool2d(x, {2, 1, false}).backward(BasicTensor<double>::from({1, 1, 1, 2}, {3, 5}));
    const double want[] = {3, 5, 0, 0, 0, 0};
    for (Index i = 0; i < 6; ++i) CHECK(x.grad()[i] == want[i]);
  }
}

TEST_CASE("max_pool2d passes NaN on") {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  for (Index at = 0; at < 4; ++at) {
    auto x = BasicTensor<double>::from({1, 1, 2, 2}, {1, 2, 3, 4});
    x[at] = nan;
    BasicVar<double> v(x, true);
    const auto y = max_pool2d(v, {2, 2, false});
    CHECK(std::isnan(y.value()[0]));
    y.backward();
    for (Index i = 0; i < 4; ++i) CHECK(v.grad()[i] == (i == at ? 1 : 0));
  }
}

TEST_CASE("max_pool2d does not depend on the number of threads") {
  const auto x = test::normal({3, 5, 70, 71}, 3).cast<float>();
  Var one(x.clone(), true), two(x.clone(), true);
  set_threads(1);
  const auto a = max_pool2d(one, {3, 2, true});
  a.backward(a.value());
  set_threads(2);
  const auto b = max_pool2d(two, {3, 2, true});
  b.backward(b.value());
  set_threads(0);
  for (Index i = 0; i < x.count(); ++i) REQUIRE(one.grad()[i] == two.grad()[i]);
}

TEST_CASE("max_pool2d refuses what does not fit") {
  const auto x = [](const Shape& s) { return BasicVar<double>(BasicTensor<double>(s)); };
  CHECK_THROWS_WITH_AS(max_pool2d(x({2, 3, 2, 9}), {3, 2, false}),
                       "max_pool2d: x has shape [2,3,2,9], expected room for a window of 3 x 3",
                       ShapeError);
  CHECK_THROWS_WITH_AS(max_pool2d(x({1, 1, 1, 9}), {3, 2, true}),
                       "max_pool2d: x has shape [1,1,1,9], expected room for a window of 3 x 3",
                       ShapeError);
  CHECK_THROWS_WITH_AS(max_pool2d(x({3, 2, 9}), {3, 2, true}),
                       "max_pool2d: x has shape [3,2,9], expected [B C H W]", ShapeError);
  CHECK_THROWS_WITH_AS(max_pool2d(x({1, 3, 2, 9}), {2, 0, true}),
                       "max_pool2d: kernel 2 and stride 0, expected positive numbers", ConfigError);
}

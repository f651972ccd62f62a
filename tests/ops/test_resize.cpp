// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/ops/resize.h"
#include "satsurf/ops/resize_kernels.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "tests/gradcheck.h"
#include "tests/isa_variants.h"

using namespace satsurf;
using test::gradcheck;
using test::normal;

namespace {

// in height and width, out height and width
const std::array<Index, 4> kSizes[] = {
    {5, 7, 10, 14}, {5, 7, 3, 4}, {6, 4, 3, 2},   {1, 1, 4, 3}, {3, 5, 1, 1},
    {4, 3, 4, 3},   {2, 9, 7, 9}, {7, 2, 5, 31},  {3, 4, 9, 8}, {8, 33, 16, 66},
    {3, 37, 5, 74}, {1, 1, 2, 2}, {1, 19, 2, 38}, {2, 1, 4, 2}};

double pixel(const BasicTensor<double>& x, Index p, Index H, Index W, Index y, Index u) {
  return x[(p * H + std::clamp<Index>(y, 0, H - 1)) * W + std::clamp<Index>(u, 0, W - 1)];
}

}  // namespace

TEST_CASE("resize agrees with its definition") {
  for (const auto& [H, W, h, w] : kSizes) {
    CAPTURE(H);
    CAPTURE(W);
    CAPTURE(h);
    CAPTURE(w);
    const auto x = normal({2, 3, H, W}, 1);
    const auto nearest = resize_nearest(BasicVar<double>(x), h, w).value();
    const auto bilinear = resize_bilinear(BasicVar<double>(x), h, w).value();
    const auto nearest_f = resize_nearest(Var(x.cast<float>()), h, w).value();
    const auto bilinear_f = resize_bilinear(Var(x.cast<float>()), h, w).value();
    REQUIRE(nearest.shape() == Shape{2, 3, h, w});
    REQUIRE(bilinear.shape() == Shape{2, 3, h, w});
    for (Index p = 0; p < 6; ++p)
      for (Index i = 0; i < h; ++i)
        for (Index j = 0; j < w; ++j) {
          const Index at = (p * h + i) * w + j;
          const double want =
              pixel(x, p, H, W, (2 * i + 1) * H / (2 * h), (2 * j + 1) * W / (2 * w));
          REQUIRE(nearest[at] == want);
          REQUIRE(nearest_f[at] == static_cast<float>(want));
          const double y =
              (static_cast<double>(i) + 0.5) * static_cast<double>(H) / static_cast<double>(h) -
              0.5;
          const double u =
              (static_cast<double>(j) + 0.5) * static_cast<double>(W) / static_cast<double>(w) -
              0.5;
          const auto y0 = static_cast<Index>(std::floor(y)), u0 = static_cast<Index>(std::floor(u));
          const double fy = y - std::floor(y), fu = u - std::floor(u);
          const double mix = (1 - fy) * ((1 - fu) * pixel(x, p, H, W, y0, u0) +
                                         fu * pixel(x, p, H, W, y0, u0 + 1)) +
                             fy * ((1 - fu) * pixel(x, p, H, W, y0 + 1, u0) +
                                   fu * pixel(x, p, H, W, y0 + 1, u0 + 1));
          REQUIRE(std::abs(bilinear[at] - mix) < 1e-13);
          REQUIRE(std::abs(static_cast<double>(bilinear_f[at]) - mix) < 2e-6);
        }
  }
}

TEST_CASE_TEMPLATE("resize kernels of every instruction set", T, float, double) {
  constexpr Index kMost = 67;
  const T guard = T(9);
  const double tolerance = std::is_same_v<T, float> ? 2e-6 : 1e-14;
  const auto x = normal({5, 2 * kMost + 2}, 1).cast<T>();
  const auto at = [&](Index row, Index i) {  // element -1 is there
    return static_cast<double>(x[row * (2 * kMost + 2) + 1 + i]);
  };
  const T weight[] = {T(0.25), T(-2), T(1), T(0.5), T(3)};
  const T* rows[5];
  for (Index r = 0; r < 5; ++r) rows[r] = x.data() + r * (2 * kMost + 2) + 1;
  for (const auto& k : test::kernel_variants<ResizeKernels<T>>())
    for (const Index n : {1, 2, 3, 7, 8, 9, 15, 16, 17, 31, 67}) {
      CAPTURE(k.name);
      CAPTURE(n);
      const auto same = [&](const BasicTensor<T>& y, Index count, const auto& want) {
        for (Index i = 0; i < y.count(); ++i) {
          CAPTURE(i);
          if (i < count)
            CHECK(std::abs(static_cast<double>(y[i]) - want(i)) < 10 * tolerance);
          else
            CHECK(y[i] == guard);
        }
      };
      for (Index count = 1; count <= 5; ++count) {
        BasicTensor<T> y({kMost + 1}, guard);
        k.mix(count, rows, weight, n, y.data());
        same(y, n, [&](Index i) {
          double sum = 0;
          for (Index r = 0; r < count; ++r) sum += static_cast<double>(weight[r]) * at(r, i);
          return sum;
        });
      }
      BasicTensor<T> between({kMost + 1}, guard), added({kMost + 1}, guard),
          twice({2 * kMost + 1}, guard), sums({kMost + 1}, guard), more({kMost + 1}, guard),
          expanded({2 * kMost + 1}, guard), back({kMost + 1}, guard), alone({kMost + 1}, guard),
          times({kMost + 1}, guard);
      k.between(n, rows[0], rows[1], T(0.75), between.data());
      same(between, n, [&](Index i) { return 0.25 * at(0, i) + 0.75 * at(1, i); });
      k.scaled(n, rows[0], T(0.5), true, added.data());
      same(added, n, [&](Index i) { return 9 + 0.5 * at(0, i); });
      k.scaled(n, rows[0], T(0.5), false, times.data());
      same(times, n, [&](Index i) { return 0.5 * at(0, i); });
      k.repeat(n, rows[0], twice.data());
      for (Index i = 0; i < twice.count(); ++i)
        CHECK(twice[i] == (i < 2 * n ? rows[0][i / 2] : guard));
      k.pair_sums(n, rows[0], T(0.5), false, sums.data());
      same(sums, n, [&](Index i) { return 0.5 * (at(0, 2 * i) + at(0, 2 * i + 1)); });
      k.pair_sums(n, rows[0], T(2), true, more.data());
      same(more, n, [&](Index i) { return 9 + 2 * (at(0, 2 * i) + at(0, 2 * i + 1)); });
      k.expand(n, rows[0], expanded.data());
      same(expanded, 2 * n, [&](Index i) {
        return 0.75 * at(0, i / 2) + 0.25 * at(0, i / 2 + (i % 2 == 0 ? -1 : 1));
      });
      k.expand_backward(n, rows[0], true, back.data());
      same(back, n, [&](Index i) {
        return 9 + 0.75 * (at(0, 2 * i) + at(0, 2 * i + 1)) +
               0.25 * (at(0, 2 * i - 1) + at(0, 2 * i + 2));
      });
      k.expand_backward(n, rows[0], false, alone.data());
      same(alone, n, [&](Index i) {
        return 0.75 * (at(0, 2 * i) + at(0, 2 * i + 1)) +
               0.25 * (at(0, 2 * i - 1) + at(0, 2 * i + 2));
      });
    }
}

TEST_CASE("twice the size keeps a constant to the bit") {
  const Var x(Tensor({2, 5, 37}, 0.1f));
  const Tensor y = resize_bilinear(x, 10, 74).value();
  for (Index i = 0; i < y.count(); ++i) REQUIRE(y[i] == 0.1f);
}

TEST_CASE("resize_nearest copies, and leaves infinity as it is") {
  const float inf = std::numeric_limits<float>::infinity();
  for (const Index width : {2, 4, 7, 8, 12}) {
    CAPTURE(width);
    const Var x(Tensor({3, 4}, inf), true);
    const Var y = resize_nearest(x, 5, width);
    for (Index i = 0; i < y.count(); ++i) CHECK(y.value()[i] == inf);
    y.backward(Tensor(y.shape(), inf));
    for (Index i = 0; i < x.count(); ++i)
      CHECK((x.grad()[i] == inf || (width < 4 && x.grad()[i] == 0)));
  }
}

TEST_CASE("area_downsample takes the mean of each block") {
  for (const Index factor : {1, 2, 3, 4, 6, 8, 12}) {
    CAPTURE(factor);
    const Index H = 5 * factor, W = 3 * factor;
    const auto x = normal({2, H, W}, 2);
    const auto y = area_downsample(BasicVar<double>(x), factor).value();
    REQUIRE(y.shape() == Shape{2, 5, 3});
    for (Index p = 0; p < 2; ++p)
      for (Index i = 0; i < 5; ++i)
        for (Index j = 0; j < 3; ++j) {
          double want = 0;
          for (Index a = 0; a < factor; ++a)
            for (Index b = 0; b < factor; ++b)
              want += x[(p * H + i * factor + a) * W + j * factor + b];
          CHECK(y[(p * 5 + i) * 3 + j] ==
                doctest::Approx(want / static_cast<double>(factor * factor)));
        }
  }
}

TEST_CASE("resize gradients") {
  using V = test::DoubleVars;
  for (const auto& size : kSizes) {
    const Index H = size[0], W = size[1], h = size[2], w = size[3];
    CAPTURE(H);
    CAPTURE(W);
    CAPTURE(h);
    CAPTURE(w);
    const auto x = normal({2, 2, H, W}, 3);
    CHECK(gradcheck([=](const V& v) { return resize_nearest(v[0], h, w); }, {x}));
    CHECK(gradcheck([=](const V& v) { return resize_bilinear(v[0], h, w); }, {x}));
  }
  for (const Index factor : {1, 2, 3, 4, 6}) {
    CAPTURE(factor);
    CHECK(gradcheck([=](const V& v) { return area_downsample(v[0], factor); },
                    {normal({2, 2, 2 * factor, 3 * factor}, 4)}));
  }
  CHECK(gradcheck([](const V& v) { return area_downsample(v[0], 2); }, {normal({2, 2, 4, 38}, 5)}));
}

TEST_CASE("bilinear resizing keeps a plane inside the map") {
  // f = 3 + 2 x - y at pixel centres stays that function of position when the pixels shrink.
  BasicTensor<double> x({4, 5});
  for (Index i = 0; i < 20; ++i)
    x[i] = 3 + 2 * static_cast<double>(i % 5) - static_cast<double>(i / 5);
  const auto y = resize_bilinear(BasicVar<double>(x), 12, 15).value();
  for (Index i = 1; i < 11; ++i)
    for (Index j = 1; j < 14; ++j) {
      const double u = (static_cast<double>(j) + 0.5) / 3 - 0.5,
                   v = (static_cast<double>(i) + 0.5) / 3 - 0.5;
      CHECK(y[i * 15 + j] == doctest::Approx(3 + 2 * u - v).epsilon(1e-13));
    }
}

TEST_CASE("resizing gives the same bits for any number of threads") {
  const auto x = normal({3, 67, 90}, 5).cast<float>();
  const auto run = [&](int threads) {
    set_threads(threads);
    const Var a(x, true);
    const Var y = resize_bilinear(resize_nearest(a, 134, 180), 201, 111);
    y.backward(Tensor(y.shape(), 0.3f));
    const Var z = area_downsample(resize_bilinear(a, 134, 180), 2);
    z.backward(x);
    const Var w = area_downsample(resize_bilinear(resize_nearest(a, 67, 180), 134, 360), 2);
    w.backward(w.value());
    set_threads(0);
    return std::vector<Tensor>{y.value(), z.value(), w.value(), a.grad()};
  };
  const auto one = run(1), two = run(2);
  for (std::size_t k = 0; k < one.size(); ++k)
    for (Index i = 0; i < one[k].count(); ++i) REQUIRE(one[k][i] == two[k][i]);
}

TEST_CASE("resize refuses") {
  const Var x(Tensor({2, 4, 6})), line(Tensor({4}));
  CHECK_THROWS_WITH_AS(resize_nearest(x, 0, 3),
                       "resize_nearest: size 0 x 3, expected at least 1 x 1", ShapeError);
  CHECK_THROWS_WITH_AS(resize_bilinear(x, 3, -1),
                       "resize_bilinear: size 3 x -1, expected at least 1 x 1", ShapeError);
  CHECK_THROWS_WITH_AS(resize_bilinear(line, 2, 2),
                       "resize_bilinear: x has shape [4], expected a non-empty [... H W]",
                       ShapeError);
  CHECK_THROWS_WITH_AS(
      area_downsample(x, 4),
      "area_downsample: x has shape [2,4,6], expected [... H W] with H and W multiples of factor 4",
      ShapeError);
  CHECK_THROWS_AS(area_downsample(x, 0), ShapeError);
}

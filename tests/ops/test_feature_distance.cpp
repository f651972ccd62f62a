// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/ops/feature_distance.h"

#include <array>
#include <cmath>

#include "tests/gradcheck.h"

using namespace satsurf;
using test::gradcheck;
using test::normal;

namespace {

double by_definition(const BasicTensor<double>& f, const BasicTensor<double>& r,
                     const BasicTensor<double>& weight) {
  const Index B = f.dim(0), C = f.dim(1), P = f.dim(2) * f.dim(3);
  double sum = 0;
  for (Index b = 0; b < B; ++b)
    for (Index i = 0; i < P; ++i) {
      double ff = 0, rr = 0;
      for (Index c = 0; c < C; ++c) {
        ff += f[(b * C + c) * P + i] * f[(b * C + c) * P + i];
        rr += r[(b * C + c) * P + i] * r[(b * C + c) * P + i];
      }
      for (Index c = 0; c < C; ++c)
        sum += weight[c] * std::pow(f[(b * C + c) * P + i] / (std::sqrt(ff) + 1e-10) -
                                        r[(b * C + c) * P + i] / (std::sqrt(rr) + 1e-10),
                                    2);
    }
  return sum / static_cast<double>(B * P);
}

}  // namespace

TEST_CASE("feature_distance agrees with its definition") {
  const std::array<Index, 4> sizes[] = {{2, 3, 5, 7}, {1, 1, 1, 1}, {2, 5, 11, 13}, {3, 2, 16, 16}};
  for (const auto& [B, C, H, W] : sizes) {
    CAPTURE(C);
    CAPTURE(H);
    auto f = normal({B, C, H, W}, 1), r = normal({B, C, H, W}, 2), w = normal({C}, 3);
    for (Index c = 0; c < C; ++c) f[c * H * W] = 0;  // a pixel without any feature
    const double want = by_definition(f, r, w);
    CHECK(feature_distance(BasicVar<double>(f), r, w).value().item() ==
          doctest::Approx(want).epsilon(1e-12));
    CHECK(
        static_cast<double>(feature_distance(Var(f.cast<float>()), r.cast<float>(), w.cast<float>())
                                .value()
                                .item()) == doctest::Approx(want).epsilon(1e-5));
    CHECK(feature_distance(BasicVar<double>(r), r, w).value().item() == 0);
  }
}

TEST_CASE("feature_distance gradient") {
  const auto r = normal({2, 3, 11, 13}, 4), w = normal({3}, 5);
  CHECK(gradcheck([&](auto& v) { return feature_distance(v[0], r, w); },
                  {normal({2, 3, 11, 13}, 6)}));
  SUBCASE("no features, no gradient") {
    BasicVar<double> none(BasicTensor<double>({1, 2, 1, 2}), true);
    feature_distance(none, normal({1, 2, 1, 2}, 7), normal({2}, 8)).backward();
    for (const double g : none.grad().values()) CHECK(g == 0);
  }
}

TEST_CASE_TEMPLATE("feature_distance does not depend on the number of threads", T, float, double) {
  const auto f = normal({2, 3, 21, 23}, 9).cast<T>(), r = normal({2, 3, 21, 23}, 10).cast<T>();
  const auto w = normal({3}, 11).cast<T>();
  BasicVar<T> one(f.clone(), true), two(f.clone(), true);
  set_threads(1);
  const auto a = feature_distance(one, r, w);
  a.backward();
  set_threads(2);
  const auto b = feature_distance(two, r, w);
  b.backward();
  set_threads(0);
  CHECK(a.value().item() == b.value().item());
  for (Index i = 0; i < f.count(); ++i) REQUIRE(one.grad()[i] == two.grad()[i]);
}

TEST_CASE("feature_distance refuses what does not fit") {
  const BasicVar<double> f(BasicTensor<double>({2, 3, 4, 5}));
  const BasicTensor<double> r({2, 3, 4, 5}), w({3});
  CHECK_THROWS_WITH_AS(feature_distance(f, BasicTensor<double>({2, 3, 5, 4}), w),
                       "feature_distance: reference has shape [2,3,5,4], expected [B C H W] with "
                       "B=2 from features, C=3 from features, H=4 from features, W=5 from features",
                       ShapeError);
  CHECK_THROWS_WITH_AS(
      feature_distance(f, r, BasicTensor<double>({4})),
      "feature_distance: weight has shape [4], expected [C] with C=3 from features", ShapeError);
  CHECK_THROWS_WITH_AS(
      feature_distance(BasicVar<double>(BasicTensor<double>({2, 3, 0, 5})),
                       BasicTensor<double>({2, 3, 0, 5}), w),
      "feature_distance: features has shape [2,3,0,5], expected at least one element", ShapeError);
}

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/ops/elementwise.h"
#include "satsurf/ops/ssi_loss.h"

#include <cmath>
#include <limits>

#include "tests/gradcheck.h"
#include "tests/ref/ssi_ref.h"

using namespace satsurf;
using test::gradcheck;
using test::normal;
using Double = BasicTensor<double>;

namespace {

struct Size {
  Index H, W;
};

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

/// Three maps with holes: one plain, one without any valid pixel, one whose target is constant.
struct Scene {
  Double x, y, valid;

  Scene(Index H, Index W)
      : x(normal({3, H, W}, 1, 2)), y(normal({3, H, W}, 2, 9)), valid({3, H, W}, 1.0) {
    const auto dice = normal({3, H, W}, 3);
    for (Index i = 0; i < x.count(); ++i) {
      if (dice[i] > 0.8 || i / (H * W) == 1) valid[i] = 0;
      if (i / (H * W) == 2) y[i] = 0.7;
    }
  }
  void spoil_holes(Double& t) const {
    for (Index i = 0; i < t.count(); ++i)
      if (valid[i] == 0) t[i] = kNan;
  }
};

}  // namespace

TEST_CASE("ssi loss by hand") {
  // x^ = -1, -1, 1, 1 and y^ = -1, 1, -1, 1; the fifth pixel does not count
  const Double x = Double::from({1, 1, 5}, {3, 3, 7, 7, kNan}),
               y = Double::from({1, 1, 5}, {10, 12, 10, 12, 80}),
               valid = Double::from({1, 1, 5}, {1, 1, 1, 1, 0});
  const auto loss = ssi_loss(BasicVar<double>(x), y, valid, {.scales = 3, .eps = 1e-15});
  CHECK(loss.maps == 1);
  CHECK(loss.distance.value().item() == doctest::Approx(1));  // |0|, |-2|, |2|, |0|
  // neighbours differ by -2, 4, -2; every second pixel by 2; the fourth is not there to compare
  CHECK(loss.gradient.value().item() == doctest::Approx(8.0 / 3 + 2));
}

TEST_CASE_TEMPLATE("ssi loss equals its definition", T, float, double) {
  const double tolerance = std::is_same_v<T, float> ? 1e-6 : 1e-13;
  for (const Size size : {Size{13, 11}, Size{1, 1}, Size{1, 9}, Size{7, 2}, Size{200, 171}})
    for (const bool masked : {false, true}) {
      CAPTURE(size.H);
      CAPTURE(size.W);
      CAPTURE(masked);
      Scene s(size.H, size.W);
      s.x = s.x.cast<T>().template cast<double>();  // what float cannot hold is not the op's error
      s.y = s.y.cast<T>().template cast<double>();
      const Double valid = masked ? s.valid : Double();
      const SsiLossOptions options{.scales = 5, .eps = 0.1};
      const auto want = test::ssi_ref(s.x, s.y, valid, options);
      if (masked) s.spoil_holes(s.x), s.spoil_holes(s.y);
      const auto got =
          ssi_loss(BasicVar<T>(s.x.cast<T>()), s.y.cast<T>(), valid.cast<T>(), options);
      CHECK(got.maps == want.maps);
      CHECK(std::abs(static_cast<double>(got.distance.value().item()) - want.distance) <=
            tolerance);
      CHECK(std::abs(static_cast<double>(got.gradient.value().item()) - want.gradient) <=
            3 * tolerance);
      CHECK(want.maps == (size.H * size.W == 1 ? 0 : masked ? 1 : 2));
    }
}

TEST_CASE("ssi loss gradients") {
  Scene s(9, 7);
  s.spoil_holes(s.y);  // x keeps its holes finite for the differences
  const auto distance = [&](const Double& valid) {
    return [&s, valid](const test::DoubleVars& v) {
      return ssi_loss(v[0], s.y, valid, {.eps = 0.3}).distance;
    };
  };
  CHECK(gradcheck(distance(s.valid), {s.x}));
  CHECK(gradcheck(
      [&](const test::DoubleVars& v) {
        return ssi_loss(v[0], s.y, s.valid, {.eps = 0.3}).gradient;
      },
      {s.x}));
  const Scene whole(6, 11);
  CHECK(gradcheck(
      [&](const test::DoubleVars& v) {
        const auto loss = ssi_loss(v[0], whole.y, {}, {.scales = 3});
        return loss.distance + affine(loss.gradient, 0.7, 0.0);
      },
      {whole.x}));
}

TEST_CASE("flat and empty maps keep loss and gradient finite") {
  const auto y = normal({2, 6, 5}, 5);
  SUBCASE("constant x is pushed towards the target") {
    const BasicVar<double> x(Double({2, 6, 5}, 12.3), true);
    const auto loss = ssi_loss(x, y, {});
    CHECK(std::isfinite(loss.gradient.value().item()));
    loss.distance.backward();
    double along = 0;
    for (Index i = 0; i < y.count(); ++i) {
      REQUIRE(std::isfinite(x.grad()[i]));
      along += x.grad()[i] * y[i];
    }
    CHECK(along < -100);  // down the loss goes up the target
  }
  SUBCASE("a target without relief teaches nothing, one with little only if asked to") {
    const BasicVar<double> x(normal({2, 6, 5}, 6), true);
    const auto none = ssi_loss(x, Double({2, 6, 5}, 0.1), {});
    CHECK(none.maps == 0);
    CHECK(ssi_loss(x, y, {}, {.flat = 5}).maps == 0);
    CHECK(ssi_loss(x, y, {}, {.flat = 0.5}).maps == 2);
    (none.distance + none.gradient).backward();
    CHECK(none.distance.value().item() == 0);
    CHECK(none.gradient.value().item() == 0);
    for (Index i = 0; i < y.count(); ++i) REQUIRE(x.grad()[i] == 0);
  }
  SUBCASE("nothing valid") {
    const BasicVar<double> x(Double({2, 6, 5}, kNan), true);
    const auto loss = ssi_loss(x, y, Double({2, 6, 5}));
    (loss.distance + loss.gradient).backward();
    CHECK(loss.distance.value().item() == 0);
    CHECK(loss.gradient.value().item() == 0);
    for (Index i = 0; i < y.count(); ++i) REQUIRE(x.grad()[i] == 0);
  }
  SUBCASE("a NaN that counts stays visible") {
    auto holed = normal({2, 6, 5}, 6);
    holed[4] = kNan;
    CHECK(std::isnan(ssi_loss(BasicVar<double>(holed), y, {}).distance.value().item()));
    CHECK(std::isnan(ssi_loss(BasicVar<double>(y), holed, {}).gradient.value().item()));
  }
}

TEST_CASE("higher is higher: rising functions of the target cost nothing, falling ones most") {
  const auto y = normal({2, 9, 10}, 7);
  const auto of = [&](double scale, double shift) {
    auto x = y.clone();
    for (double& v : x.values()) v = scale * v + shift;
    const auto loss = ssi_loss(BasicVar<double>(x), y, {}, {.eps = 1e-12});
    return loss.distance.value().item() + loss.gradient.value().item();
  };
  CHECK(std::abs(of(40, 7)) < 1e-9);
  CHECK(std::abs(of(1e-3, -300)) < 1e-6);
  const auto other = ssi_loss(BasicVar<double>(normal({2, 9, 10}, 8)), y, {});
  CHECK(of(-2, 1) > other.distance.value().item() + other.gradient.value().item());
}

TEST_CASE("ssi loss gives the same bits for any number of threads") {
  const Tensor x = normal({2, 190, 203}, 11).cast<float>(),
               y = normal({2, 190, 203}, 12).cast<float>();
  std::vector<float> bits[2];
  for (const int n : {1, 2}) {
    set_threads(n);
    const Var v(x, true);
    const auto loss = ssi_loss(v, y, {});
    (loss.distance + loss.gradient).backward();
    auto& b = bits[n - 1];
    b.assign(v.grad().values().begin(), v.grad().values().end());
    b.push_back(loss.distance.value().item());
    b.push_back(loss.gradient.value().item());
  }
  set_threads(0);
  CHECK(bits[0] == bits[1]);
}

TEST_CASE("ssi loss refuses what it cannot take") {
  const BasicVar<double> x(normal({2, 4, 3}, 1));
  const auto y = normal({2, 4, 3}, 2);
  CHECK_THROWS_WITH_AS(
      ssi_loss(x, normal({2, 4, 5}, 2), {}),
      "ssi_loss: target has shape [2,4,5], expected [N H W] with N=2 from x, H=4 from x, "
      "W=3 from x",
      ShapeError);
  CHECK_THROWS_WITH_AS(
      ssi_loss(x, y, normal({1, 4, 3}, 2)),
      "ssi_loss: valid has shape [1,4,3], expected [N H W] with N=2 from x, H=4 from x, "
      "W=3 from x",
      ShapeError);
  CHECK_THROWS_WITH_AS(ssi_loss(x, y, {}, {.scales = -1}),
                       "ssi_loss: scales is -1, expected 0 to 32", ConfigError);
  CHECK_THROWS_WITH_AS(ssi_loss(x, y, {}, {.eps = 0}),
                       "ssi_loss: eps is 0.000000, expected a positive number", ConfigError);
  CHECK_THROWS_WITH_AS(ssi_loss(x, y, {}, {.flat = -1}),
                       "ssi_loss: flat is -1.000000, expected 0 or more", ConfigError);
}

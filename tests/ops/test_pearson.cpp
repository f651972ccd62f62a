// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/ops/pearson.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "tests/gradcheck.h"
#include "tests/ref/pearson_ref.h"

using namespace satsurf;
using test::gradcheck;
using test::normal;
using Double = BasicTensor<double>;

namespace {

struct Size {
  Index H, W;
};

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

PatchPearsonOptions with_grids(std::vector<PatchGrid> grids) {
  PatchPearsonOptions options;
  options.grids = std::move(grids);
  return options;
}

/// Two views with holes (NaN in both maps), one empty patch, one flat target and one flat x.
struct Scene {
  Double x, y, valid;
  PatchPearsonOptions options =
      with_grids({{.side = 3, .top = 2, .left = 1}, {.side = 4}, {.side = 8, .top = 5, .left = 3}});

  Scene(Index H, Index W, bool holes_are_nan)
      : x(normal({2, H, W}, 1, 3)), y(normal({2, H, W}, 2, 0.1)), valid({2, H, W}, 1.0) {
    const auto dice = normal({2, H, W}, 3);
    for (Index i = 0; i < x.count(); ++i) {
      const Index r = i / W % H, c = i % W;
      if (dice[i] > 0.8 || (r < 4 && c < 4 && i < H * W)) valid[i] = 0;
      if (r >= 4 && r < 8 && c < 4) x[i] = 0.7;
      y[i] = r >= 4 && r < 8 && c >= 4 && c < 8 ? 0.7 : y[i] + 0.02 * x[i];
      if (valid[i] == 0 && holes_are_nan) x[i] = y[i] = kNan;
    }
  }
};

double largest_difference(const Double& a, const Double& b) {
  double most = 0;
  for (Index i = 0; i < a.count(); ++i) {
    const double d = std::abs(a[i] - b[i]);
    if (!(d <= most)) most = d;  // keeps a NaN
  }
  return most;
}

}  // namespace

TEST_CASE("patch correlation by hand") {
  // one row of two patches; the second is invalid but for one pixel
  const Double x = Double::from({1, 2, 4}, {1, 2, 5, 9, 4, 5, 5, 5}),
               y = Double::from({1, 2, 4}, {0, 1, 5, 9, 1, 2, 5, 5}),
               valid = Double::from({1, 2, 4}, {1, 1, 0, 0, 1, 1, 0, 1});
  auto options = with_grids({{.side = 2}});
  options.min_valid = 0.5;
  const auto loss = patch_pearson(BasicVar<double>(x), y, valid, options);
  // x: mean 3, deviations -2, -1, 1, 2; y: mean 1, deviations -1, 0, 0, 1
  const double sx = std::sqrt(2.5), sy = std::sqrt(0.5), rho = 1 / ((sx + 1e-3) * sy);
  const auto view = [](std::initializer_list<double> v, double offset) {
    double m = 0, s = 0;
    for (const double e : v) m += e / 5;
    for (const double e : v) s += (e - m) * (e - m) / 5;
    return std::sqrt(s) + offset;
  };
  const double Sx = view({1, 2, 4, 5, 5}, 1e-3), Sy = view({0, 1, 1, 2, 5}, 0);
  const double dx[] = {-2, -1, 0, 0, 1, 2, 0, 0}, dy[] = {-1, 0, 0, 0, 0, 1, 0, 0};
  for (Index i = 0; i < 8; ++i) {
    CAPTURE(i);
    const bool in = i % 4 < 2;
    const double apart = dx[i] / Sx - dy[i] / Sy;
    CHECK(loss.defined[i] == (in ? 1 : 0));
    CHECK(loss.local.value()[i] == doctest::Approx(in ? 1 - rho : 0).epsilon(1e-12));
    CHECK(loss.global.value()[i] == doctest::Approx(apart * apart / 2).epsilon(1e-12));
  }
}

TEST_CASE_TEMPLATE("patch correlation equals its definition", T, float, double) {
  const double tolerance = std::is_same_v<T, float> ? 2e-5 : 1e-11;
  for (const Size size :
       {Size{13, 11}, Size{1, 1}, Size{1, 9}, Size{7, 2}, Size{8, 8}, Size{9, 23}})
    for (const bool masked : {false, true}) {
      CAPTURE(size.H);
      CAPTURE(size.W);
      CAPTURE(masked);
      Scene s(size.H, size.W, masked);
      s.x = s.x.cast<T>().template cast<double>();  // what float cannot hold is not the op's error
      s.y = s.y.cast<T>().template cast<double>();
      const Double valid = masked ? s.valid : Double();
      const auto want = test::patch_pearson_ref(s.x, s.y, valid, s.options);
      const auto got =
          patch_pearson(BasicVar<T>(s.x.cast<T>()), s.y.cast<T>(), valid.cast<T>(), s.options);
      CHECK(got.local.shape() == s.x.shape());
      CHECK(largest_difference(got.defined.template cast<double>(), want.defined) == 0);
      CHECK(largest_difference(got.local.value().template cast<double>(), want.local) <= tolerance);
      CHECK(largest_difference(got.global.value().template cast<double>(), want.global) <=
            tolerance);
      if (size.H != 13) continue;
      double counted = 0;
      for (const double d : want.defined.values()) counted += d;
      CHECK(counted > 150);  // the cut patches take part
    }
}

TEST_CASE("patch correlation gradients") {
  for (const bool holes_are_nan : {false, true}) {
    Scene s(9, 7, false);
    s.options.eps = 2;  // a difference quotient across a flat patch needs some width
    const auto frozen = test::patch_pearson_ref(s.x, s.y, s.valid, s.options).deviation_x;
    // x keeps its holes finite for the differences, the target need not
    if (holes_are_nan)
      for (Index i = 0; i < s.y.count(); ++i)
        if (s.valid[i] == 0) s.y[i] = kNan;
    CHECK(gradcheck(
        [&](const test::DoubleVars& v) {
          return patch_pearson(v[0], s.y, s.valid, s.options).local;
        },
        {s.x}));
    // differences are taken of the definition with S_x held still, as the backward pass does
    CHECK(gradcheck(
        [&](const test::DoubleVars& v) {
          if (!NoGrad::active()) return patch_pearson(v[0], s.y, s.valid, s.options).global;
          return BasicVar<double>(
              test::patch_pearson_ref(v[0].value(), s.y, s.valid, s.options, frozen).global);
        },
        {s.x}));
  }
}

TEST_CASE("flat and empty patches keep values and gradients finite") {
  const Double y = normal({2, 6, 5}, 5);
  auto options = with_grids({{.side = 3}});
  const auto n = normal({2, 6, 5}, 6);
  SUBCASE("constant x correlates with nothing and is pushed towards the target") {
    const BasicVar<double> x(Double({2, 6, 5}, 12.3), true);
    const auto loss = patch_pearson(x, y, {}, options);
    for (Index i = 0; i < y.count(); ++i) REQUIRE(loss.local.value()[i] == 1);
    loss.local.backward(Double({2, 6, 5}, 1.0));
    loss.global.backward(Double({2, 6, 5}, 1.0));
    double along = 0;
    for (Index i = 0; i < y.count(); ++i) {
      REQUIRE(std::isfinite(x.grad()[i]));
      along += x.grad()[i] * y[i];
    }
    CHECK(along < -1000);  // down the loss goes up the target
  }
  SUBCASE("a constant target defines nothing") {
    const BasicVar<double> x(n, true);
    const auto loss = patch_pearson(x, Double({2, 6, 5}, 0.1), {}, options);
    loss.local.backward(Double({2, 6, 5}, 1.0));
    loss.global.backward(Double({2, 6, 5}, 1.0));
    for (Index i = 0; i < y.count(); ++i) {
      REQUIRE(loss.defined[i] == 0);
      REQUIRE(loss.local.value()[i] == 0);
      REQUIRE(loss.global.value()[i] == 0);
      REQUIRE(x.grad()[i] == 0);
    }
  }
  SUBCASE("nothing valid") {
    const BasicVar<double> x(Double({2, 6, 5}, kNan), true);
    options.min_valid = 0;
    const auto loss = patch_pearson(x, y, Double({2, 6, 5}), options);
    loss.global.backward(Double({2, 6, 5}, 1.0));
    for (Index i = 0; i < y.count(); ++i) {
      REQUIRE(loss.global.value()[i] == 0);
      REQUIRE(x.grad()[i] == 0);
    }
  }
  SUBCASE("a NaN that counts stays visible") {
    auto holed = n.clone();
    holed[4] = kNan;
    CHECK(std::isnan(patch_pearson(BasicVar<double>(holed), y, {}, options).local.value()[3]));
    holed = y.clone();
    holed[4] = kNan;
    CHECK(std::isnan(patch_pearson(BasicVar<double>(n), holed, {}, options).local.value()[3]));
  }
}

TEST_CASE("a linear function of the target costs nothing, whatever its unit") {
  const Double y = normal({2, 9, 10}, 7);
  Double up = y.clone(), down = y.clone(), feet = y.clone(), other = normal({2, 9, 10}, 8);
  for (Index i = 0; i < y.count(); ++i) {
    up[i] = 40 * y[i] + 7;
    down[i] = -40 * y[i];
    feet[i] = 1e-4 * y[i] - 3;
  }
  auto options = with_grids({{.side = 4, .top = 1, .left = 2}, {.side = 5}});
  options.eps = 1e-9;
  const auto best = patch_pearson(BasicVar<double>(up), y, {}, options);
  const auto worst = patch_pearson(BasicVar<double>(down), y, {}, options);
  const auto one = patch_pearson(BasicVar<double>(other), y, {}, options);
  const auto same = patch_pearson(BasicVar<double>(other), feet, {}, options);
  for (Index i = 0; i < y.count(); ++i) {
    REQUIRE(std::abs(best.local.value()[i]) < 1e-9);
    REQUIRE(best.global.value()[i] < 1e-9);
    REQUIRE(worst.local.value()[i] == doctest::Approx(2 * worst.defined[i]));
    REQUIRE(same.local.value()[i] == doctest::Approx(one.local.value()[i]));
    REQUIRE(same.global.value()[i] == doctest::Approx(one.global.value()[i]));
  }
}

TEST_CASE("over one patch as large as the view the two losses have the same mean") {
  const Double x = normal({2, 7, 12}, 9), y = normal({2, 7, 12}, 10);
  auto options = with_grids({{.side = 50, .top = 3, .left = 49}});
  options.eps = 1e-12;
  const auto loss = patch_pearson(BasicVar<double>(x), y, {}, options);
  for (Index n = 0; n < 2; ++n) {
    double mean = 0;
    for (Index i = 0; i < 84; ++i) mean += loss.global.value()[n * 84 + i] / 84;
    CHECK(mean == doctest::Approx(loss.local.value()[n * 84]));
  }
}

TEST_CASE("which patches count") {
  const Double y = normal({1, 8, 8}, 11);
  const BasicVar<double> x(normal({1, 8, 8}, 12));
  const auto counted = [&](const Double& valid, const PatchPearsonOptions& options) {
    const auto loss = patch_pearson(x, y, valid, options);
    Index n = 0;
    for (const double d : loss.defined.values()) n += d == 1 ? 1 : 0;
    return n;
  };
  SUBCASE("a quarter of the pixels is enough") {
    Double valid({1, 8, 8});
    for (const Index i : {0, 1, 2, 3}) valid[i] = 1;
    CHECK(counted(valid, with_grids({{.side = 4}})) == 4);
    valid[3] = 0;
    CHECK(counted(valid, with_grids({{.side = 4}})) == 0);
  }
  SUBCASE("patches cut by the border need as much as whole ones") {
    CHECK(counted({}, with_grids({{.side = 4, .top = 1, .left = 0}})) == 64);  // strips of 1 x 4
    CHECK(counted({}, with_grids({{.side = 4, .top = 1, .left = 1}})) == 57);  // corners of 1, 3, 3
  }
  SUBCASE("a pixel that one grid leaves out has the loss of the others") {
    Double valid({1, 8, 8});
    for (const Index i : {0, 1, 8, 9}) valid[i] = 1;
    const auto small = with_grids({{.side = 2}}), both = with_grids({{.side = 2}, {.side = 8}});
    const auto a = patch_pearson(x, y, valid, small), b = patch_pearson(x, y, valid, both);
    CHECK(a.local.value()[9] == b.local.value()[9]);
    CHECK(a.local.value()[9] != 0);
  }
  SUBCASE("the target must vary") {
    auto options = with_grids({{.side = 4}});
    options.flat = 10;
    CHECK(counted({}, options) == 0);
  }
}

TEST_CASE("patch correlation gives the same bits for any number of threads") {
  const Tensor x = normal({3, 151, 133}, 13).cast<float>(),
               y = normal({3, 151, 133}, 14).cast<float>(),
               g = normal({3, 151, 133}, 15).cast<float>();
  const auto options =
      with_grids({{.side = 9, .top = 4, .left = 8}, {.side = 16}, {.side = 50, .top = 31}});
  const auto run = [&](int threads) {
    set_threads(threads);
    const Var a(x, true);
    const auto loss = patch_pearson(a, y, {}, options);
    loss.local.backward(g);
    loss.global.backward(g);
    set_threads(0);
    return std::vector<Tensor>{loss.local.value(), loss.global.value(), a.grad()};
  };
  const auto one = run(1), two = run(2);
  for (std::size_t k = 0; k < one.size(); ++k)
    for (Index i = 0; i < one[k].count(); ++i) REQUIRE(one[k][i] == two[k][i]);
}

TEST_CASE("patch correlation refuses") {
  const Var x(Tensor({2, 4, 5}));
  const Tensor y({2, 4, 5});
  const auto grid = with_grids({{.side = 4}});
  CHECK_THROWS_WITH_AS(patch_pearson(x, Tensor({2, 5, 4}), {}, grid),
                       "patch_pearson: target has shape [2,5,4], expected [N H W] with N=2 from x, "
                       "H=4 from x, W=5 from x",
                       ShapeError);
  CHECK_THROWS_AS(patch_pearson(x, y, Tensor({4, 5}), grid), ShapeError);
  const auto refuses = [&](PatchPearsonOptions options, const char* text) {
    CHECK_THROWS_WITH_AS(patch_pearson(x, y, {}, options), text, ConfigError);
  };
  refuses(with_grids({}), "patch_pearson: no grids came, expected at least one");
  refuses(with_grids({{.side = 1}}), "patch_pearson: a grid's side is 1, expected at least 2");
  refuses(with_grids({{.side = 8, .top = 8, .left = 1}}),
          "patch_pearson: a grid's corner is 8, 1, expected numbers from 0 to below its side 8");
  refuses(with_grids({{.side = 8, .top = 0, .left = -1}}),
          "patch_pearson: a grid's corner is 0, -1, expected numbers from 0 to below its side 8");
  auto options = grid;
  options.min_valid = 1.5;
  refuses(options, "patch_pearson: min_valid is 1.500000, expected 0 to 1");
  options = grid;
  options.flat = -1;
  refuses(options, "patch_pearson: flat is -1.000000, expected 0 or more");
  options = grid;
  options.eps = 0;
  refuses(options, "patch_pearson: eps is 0.000000, expected a positive number");
}

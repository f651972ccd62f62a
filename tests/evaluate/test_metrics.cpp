// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/core/rng.h"
#include "satsurf/evaluate/metrics.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::scene;
using namespace satsurf::evaluate;

namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

/// A smooth hill, two blocks and a step: nothing repeats, so a shift has one answer.
double surface(double x, double y) {
  double z = 3 * std::sin(x / 17) + 2 * std::cos(y / 11 + x / 40);
  if (x > 20 && x < 35 && y > -50 && y < -30) z += 12;
  if (x > 50 && x < 58 && y > -90 && y < -20) z += 7;
  return z;
}

HeightField sampled(Index H, Index W, double x0, double y0, double step) {
  HeightField f{Tensor({H, W}), x0, y0, step};
  for (Index i = 0; i < H; ++i)
    for (Index j = 0; j < W; ++j)
      f.z[i * W + j] = static_cast<float>(surface(x0 + (static_cast<double>(j) + 0.5) * step,
                                                  y0 - (static_cast<double>(i) + 0.5) * step));
  return f;
}

}  // namespace

TEST_CASE("psnr") {
  SUBCASE("one wrong value of six: mean square 0.25 / 6") {
    const auto a = Tensor::from({3, 1, 2}, {0, 0.5f, 1, 0.25f, 0.75f, 1});
    const auto b = Tensor::from({3, 1, 2}, {0, 0.5f, 0.5f, 0.25f, 0.75f, 1});
    CHECK(psnr(a, b) == doctest::Approx(-10 * std::log10(0.25 / 6)));
  }
  SUBCASE("values beyond [0, 1] are clipped") {
    CHECK(std::isinf(psnr(Tensor::from({1, 1, 2}, {-3, 7}), Tensor::from({1, 1, 2}, {0, 1}))));
  }
  SUBCASE("a mask holds for every channel") {
    const auto a = Tensor::from({2, 1, 2}, {0.1f, 1, 0.2f, 1}),
               b = Tensor::from({2, 1, 2}, {0, 0, 0, 0});
    CHECK(psnr(a, b, Tensor::from({1, 2}, {1, 0})) ==
          doctest::Approx(-10 * std::log10((0.01 + 0.04) / 2)));
    CHECK(std::isnan(psnr(a, b, Tensor({1, 2}))));
  }
  SUBCASE("sizes must agree") {
    CHECK_THROWS_WITH_AS(
        psnr(Tensor({3, 2, 2}), Tensor({3, 2, 1})),
        "psnr: reference has shape [3,2,1], expected [C H W] with C=3 from image, H=2 "
        "from image, W=2 from image",
        ShapeError);
  }
}

TEST_CASE("fit_colours") {
  const Index P = 4 * 5;
  Rng rng(4);
  const auto image = uniform_tensor<float>({3, 4, 5}, rng, 0.f, 1.f);
  auto reference = Tensor::uninitialised({3, 4, 5});
  for (Index i = 0; i < P; ++i)
    for (Index c = 0; c < 3; ++c)  // from two channels and a constant
      reference[c * P + i] = 0.1f + 0.5f * image[c * P + i] + 0.2f * image[(c + 1) % 3 * P + i];
  SUBCASE("an affine map is found") {
    CHECK(psnr(image, reference) < 30);
    CHECK(psnr(fit_colours(image, reference), reference) > 120);
  }
  SUBCASE("what the mask hides has no say, and is mapped all the same") {
    auto mask = Tensor({4, 5}, 1.f);
    auto spoilt = reference.clone();
    for (Index i = 0; i < 3; ++i) mask[i] = 0, spoilt[i] = 9;
    CHECK(psnr(fit_colours(image, spoilt, mask), reference) > 120);
    const Tensor same = fit_colours(image, spoilt, Tensor({4, 5}));
    CHECK(std::equal(same.values().begin(), same.values().end(), image.data()));
  }
  SUBCASE("grey pictures leave the map open, not the result") {
    auto grey = Tensor::uninitialised({3, 4, 5}), darker = Tensor::uninitialised({3, 4, 5});
    for (Index i = 0; i < 3 * P; ++i) grey[i] = image[i % P], darker[i] = 0.5f * image[i % P];
    CHECK(psnr(fit_colours(grey, darker), darker) > 120);
  }
  SUBCASE("sizes must agree") {
    CHECK_THROWS_AS(fit_colours(image, Tensor({1, 4, 5})), ShapeError);
    CHECK_THROWS_AS(fit_colours(image, reference, Tensor({5, 4})), ShapeError);
  }
}

TEST_CASE("score_heights") {
  // errors: 0.5, -1 (not below 1), 2.5 (not below 2.5), -7, missing, no truth, 9
  const auto truth = Tensor::from({1, 7}, {10, 10, 10, 10, 10, kNan, 10});
  const auto found = Tensor::from({1, 7}, {10.5f, 9, 12.5f, 3, kNan, 1, 19});
  SUBCASE("by hand") {
    const HeightScores s = score_heights(found, truth);
    CHECK(s.truth == 6);
    CHECK(s.compared == 5);
    CHECK(s.completeness == doctest::Approx(5.0 / 6));
    CHECK(s.mae == doctest::Approx((0.5 + 1 + 2.5 + 7 + 9) / 5));
    CHECK(s.rmse == doctest::Approx(std::sqrt((0.25 + 1 + 6.25 + 49 + 81) / 5)));
    CHECK(s.median == doctest::Approx(0.5));
    CHECK(s.nmad == doctest::Approx(1.4826 * 2));  // |e - 0.5| = 0 1.5 2 7.5 8.5
    CHECK(s.pag1 == doctest::Approx(1.0 / 6));
    CHECK(s.pag2_5 == doctest::Approx(2.0 / 6));
    CHECK(s.pag7_5 == doctest::Approx(4.0 / 6));
    CHECK(s.pag1_compared == doctest::Approx(1.0 / 5));
    CHECK(s.pag2_5_compared == doctest::Approx(2.0 / 5));
    CHECK(s.pag7_5_compared == doctest::Approx(4.0 / 5));
  }
  SUBCASE(
      "masked cells do not count; an even number of errors has the mean of the middle two as "
      "median") {
    const HeightScores s = score_heights(found, truth, Tensor::from({1, 7}, {1, 1, 1, 1, 0, 1, 0}));
    CHECK(s.truth == 4);
    CHECK(s.completeness == 1);
    CHECK(s.median == doctest::Approx(-0.25));
  }
  SUBCASE("nothing to compare is NaN, not zero") {
    const HeightScores s = score_heights(found, truth, Tensor({1, 7}));
    CHECK(s.truth == 0);
    CHECK(std::isnan(s.mae));
    CHECK(std::isnan(s.completeness));
    CHECK(std::isnan(s.median));
  }
}

TEST_CASE("resample") {
  // 2 x 3 cells of 2 m, upper-left corner at (10, 20)
  HeightField f{Tensor::from({2, 3}, {0, 2, 4, 10, 12, 14}), 10, 20, 2};
  SUBCASE("onto itself") {
    const Tensor z = resample(f, f);
    for (Index i = 0; i < 6; ++i) CHECK(z[i] == f.z[i]);
  }
  SUBCASE("bilinear between four, nearest at the border, NaN outside") {
    // cells of 1 m from x = 9 to 17, y = 20 to 18: centres at x = 9.5 (outside), 10.5, 11.5, ...; y
    // = 19.5, 18.5
    const Tensor z = resample(f, {Tensor({2, 8}), 9, 20, 1});
    CHECK(std::isnan(z[0]));
    CHECK(z[1] == 0);                       // nearest
    CHECK(z[8 + 2] == doctest::Approx(3));  // u = 0.25, v = 0.25: 0.5 + 2.5
    CHECK(z[8 + 3] == doctest::Approx(4));  // u = 0.75, v = 0.25
    CHECK(z[8 + 6] == 4);                   // u = 2.25: nearest
    CHECK(std::isnan(z[7]));
  }
  SUBCASE("beside a hole the nearest cell, in it NaN") {
    f.z[1] = kNan;
    const Tensor z = resample(f, {Tensor({2, 8}), 9, 20, 1});
    CHECK(z[8 + 2] == 0);         // u = 0.25: nearest is cell 0
    CHECK(std::isnan(z[8 + 3]));  // u = 0.75: nearest is the hole
  }
  SUBCASE("a grid far away is unknown everywhere") {
    const Tensor z = resample(f, {Tensor({1, 2}), 1e30, -1e30, 1});
    CHECK(std::isnan(z[0]));
  }
}

TEST_CASE("an offset is taken for the geoid's where it is as large") {
  CHECK(like_geoid(27.5, 29.0));
  CHECK(like_geoid(-27.5, 29.0));
  CHECK(like_geoid(28.0, -29.0));
  CHECK_FALSE(like_geoid(12.0, 29.0));
  CHECK(like_geoid(12.0, -13.0));
  CHECK_FALSE(like_geoid(12.0, {}));
  CHECK(like_geoid(-40.0, {}));
}

TEST_CASE("compare_dsm") {
  const HeightField truth = sampled(210, 170, 0, 0, 0.5);
  SUBCASE("a known offset is found and taken out") {
    // the prediction says everything 3 cells too far east, 7 too far north and 1.5 m too high
    HeightField found = truth;
    found.z = truth.z.clone();
    for (float& v : found.z.values()) v += 1.5f;
    found.x0 += 3 * 0.5, found.y0 += 7 * 0.5;
    const DsmComparison c = compare_dsm(found, truth, Registration::xyz);
    CHECK(c.shift[0] == doctest::Approx(-1.5));
    CHECK(c.shift[1] == doctest::Approx(-3.5));
    CHECK(c.shift[2] == doctest::Approx(-1.5));
    CHECK(c.raw.mae > 1);
    CHECK(c.registered.mae < 1e-5);
    CHECK(c.registered.completeness == 1);
    CHECK(c.error.shape() == Shape{210, 170});

    const DsmComparison z = compare_dsm(found, truth, Registration::z);
    CHECK(z.shift[0] == 0);
    CHECK(z.registered.mae > 0.1);
    CHECK(z.raw.mae == c.raw.mae);
    const DsmComparison none = compare_dsm(found, truth, Registration::none);
    CHECK(none.registered.mae == none.raw.mae);
    CHECK(none.shift == std::array<double, 3>{0, 0, 0});
  }
  SUBCASE("a large shift is found through the pyramid, noise and holes notwithstanding") {
    HeightField found = sampled(230, 190, 4.5, 6, 0.45);  // another grid altogether
    Rng rng(3);
    for (float& v : found.z.values())
      v = rng.chance(0.2) ? kNan : v + 0.3f * static_cast<float>(rng.normal());
    found.x0 += 6.5, found.y0 -= 5;
    const DsmComparison c = compare_dsm(found, truth, Registration::xyz);
    CHECK(c.shift[0] == doctest::Approx(-6.5));
    CHECK(c.shift[1] == doctest::Approx(5));
    CHECK(c.registered.nmad < 0.5);
    set_threads(1);
    const DsmComparison one = compare_dsm(found, truth, Registration::xyz);
    set_threads(2);
    const DsmComparison two = compare_dsm(found, truth, Registration::xyz);
    set_threads(0);
    CHECK(one.registered.mae == two.registered.mae);
    CHECK(one.shift == two.shift);
  }
  SUBCASE("a surface is not moved off its bad cells") {
    // Right but for towers at the eastern rim, which a shift by 8 cells moves off the truth.
    HeightField found = truth;
    found.z = truth.z.clone();
    for (Index i = 0; i < found.z.count(); ++i)
      if (i % 170 >= 162 && i / 170 / 20 % 2 == 0) found.z[i] += 20;
    const DsmComparison c = compare_dsm(found, truth, Registration::xyz),
                        z = compare_dsm(found, truth, Registration::z);
    CHECK(c.registered.mae == z.registered.mae);
    CHECK(c.shift == z.shift);
    REQUIRE(c.refused_shift);
    CHECK((*c.refused_shift)[0] > 2);
  }
  SUBCASE("nor further than any camera is off") {
    const HeightField wide = sampled(400, 400, 0, 0, 0.5);
    HeightField found = wide;
    found.x0 += 24;
    const DsmComparison far = compare_dsm(found, wide, Registration::xyz);
    CHECK(std::abs(far.shift[0]) <= kFarthestShift);
    CHECK(std::abs(far.shift[1]) <= kFarthestShift);
    found.x0 -= 24 - 14.5;
    CHECK(compare_dsm(found, wide, Registration::xyz).shift[0] == doctest::Approx(-14.5));
  }
  SUBCASE("equal surfaces stay where they are, flat ones too") {
    CHECK(compare_dsm(truth, truth, Registration::xyz).shift == std::array<double, 3>{0, 0, 0});
    const HeightField flat{Tensor({5, 7}, 2.f), 0, 0, 1};
    CHECK(compare_dsm(flat, flat, Registration::xyz).shift == std::array<double, 3>{0, 0, 0});
  }
  SUBCASE("masked cells steer neither the registration nor the scores") {
    HeightField found = truth;
    found.z = truth.z.clone();
    Tensor mask({210, 170}, 1.f);
    for (Index i = 0; i < 210 * 85; ++i) found.z[i] += 40, mask[i] = 0;
    const DsmComparison c = compare_dsm(found, truth, Registration::z, mask);
    CHECK(c.shift[2] == 0);
    CHECK(c.registered.truth == 210 * 170 - 210 * 85);
    CHECK(c.registered.mae == 0);
    CHECK(std::isnan(c.error[0]));
  }
  SUBCASE("surfaces that do not meet are refused") {
    HeightField far = truth;
    far.x0 = 1e6;
    CHECK_THROWS_WITH_AS(compare_dsm(far, truth, Registration::none),
                         "compare_dsm: no cell with both a predicted and a true height, expected "
                         "overlapping surfaces",
                         Error);
  }
  SUBCASE("or all cells are missing") {
    HeightField nothing = truth;
    nothing.z = Tensor({210, 170}, kNan);
    Tensor mask({210, 170});
    for (Index i = 0; i < 100; ++i) mask[i] = 1;
    for (const Registration r : {Registration::none, Registration::z, Registration::xyz}) {
      const DsmComparison c = compare_dsm(nothing, truth, r, mask, false);
      CHECK(c.shift == std::array<double, 3>{0, 0, 0});
      for (const HeightScores& s : {c.raw, c.registered}) {
        CHECK(s.truth == 100);
        CHECK(s.compared == 0);
        CHECK(s.completeness == 0);
        CHECK(s.pag1 == 0);
        CHECK(s.pag7_5 == 0);
        CHECK(std::isnan(s.pag7_5_compared));
        CHECK(std::isnan(s.mae));
      }
      CHECK(c.error.shape() == Shape{210, 170});
      CHECK(std::isnan(c.error[0]));
    }
    const DsmComparison met = compare_dsm(truth, truth, Registration::z, mask, false);
    CHECK(met.registered.completeness == 1);
    CHECK(met.registered.mae == 0);
  }
}

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/ops/ssim.h"
#include "satsurf/ops/ssim_kernels.h"

#include <array>
#include <cmath>
#include <limits>
#include <vector>

#include "tests/gradcheck.h"
#include "tests/isa_variants.h"
#include "tests/ref/ssim_ref.h"

using namespace satsurf;
using test::gradcheck;

namespace {

/// Images in [0, 1] with neighbours that are alike.
BasicTensor<double> picture(const Shape& shape, std::uint64_t seed) {
  auto t = test::normal(shape, seed, 0.15);
  const Index W = shape[shape.rank() - 1];
  for (Index i = 0; i < t.count(); ++i)
    t[i] = std::clamp(0.5 +
                          0.3 * std::sin(static_cast<double>(i / W) * 0.4) *
                              std::cos(static_cast<double>(i % W) * 0.3) +
                          t[i],
                      0.0, 1.0);
  return t;
}

BasicTensor<double> like(const BasicTensor<double>& x, std::uint64_t seed, double sigma) {
  const auto noise = test::normal(x.shape(), seed, sigma);
  auto y = x.clone();
  for (Index i = 0; i < y.count(); ++i) y[i] = std::clamp(0.9 * y[i] + noise[i], 0.0, 1.0);
  return y;
}

/// About one pixel in five does not count, and a corner.
BasicTensor<double> holes(Index H, Index W, std::uint64_t seed) {
  auto m = test::normal({H, W}, seed);
  for (Index i = 0; i < H; ++i)
    for (Index j = 0; j < W; ++j)
      m[i * W + j] = m[i * W + j] < -0.8 || (i < H / 3 && j < W / 3) ? 0 : 1;
  return m;
}

double similarity(const BasicTensor<double>& x, const BasicTensor<double>& y, SsimKind kind,
                  const BasicTensor<double>& mask = {}) {
  return ssim(BasicVar<double>(x), y, kind, mask).value().item();
}

struct Convention {
  SsimKind kind;
  test::SsimRef ref;
};
const Convention kConventions[] = {{SsimKind::skimage, test::kSkimageRef},
                                   {SsimKind::conv, test::kConvRef}};

}  // namespace

TEST_CASE("ssim agrees with its definition") {
  const std::array<Index, 2> sizes[] = {{11, 11}, {12, 17}, {33, 13}, {14, 45},
                                        {1, 1},   {3, 29},  {7, 5},   {11, 10}};
  for (const auto& [H, W] : sizes)
    for (const auto& [kind, ref] : kConventions) {
      if (kind == SsimKind::skimage && (H < 11 || W < 11)) continue;
      CAPTURE(H);
      CAPTURE(W);
      CAPTURE(kind == SsimKind::conv);
      const auto x = picture({2, 3, H, W}, 1), y = like(x, 2, 0.1);
      const double want = test::ssim_ref(x, y, nullptr, 6, H, W, ref);
      CHECK(similarity(x, y, kind) == doctest::Approx(want).epsilon(1e-12));
      CHECK(static_cast<double>(ssim(Var(x.cast<float>()), y.cast<float>(), kind).value().item()) ==
            doctest::Approx(want).epsilon(2e-5));
      CHECK(similarity(x.reshaped({6, H, W}), y.reshaped({6, H, W}), kind) ==
            similarity(x, y, kind));
    }
}

TEST_CASE("ssim_score is ssim in double, bit by bit") {
  for (const auto& [C, H, W] : {std::array<Index, 3>{1, 11, 12}, {3, 37, 29}, {2, 70, 15}}) {
    const auto x = picture({C, H, W}, 4).cast<float>();
    const auto y = like(picture({C, H, W}, 4), 5, 0.1).cast<float>();
    Tensor mask({H, W}, 1.F);
    for (Index i = 0; i < mask.count(); i += 5) mask[i] = 0;
    for (const SsimKind kind : {SsimKind::skimage, SsimKind::conv})
      for (const Tensor& counts : {Tensor(), mask}) {
        const auto wide = counts.empty() ? BasicTensor<double>() : counts.cast<double>();
        CHECK(
            ssim_score(x, y, kind, counts) ==
            ssim(BasicVar<double>(x.cast<double>()), y.cast<double>(), kind, wide).value().item());
      }
  }
  CHECK(ssim_score(Tensor({1, 12, 12}), Tensor({1, 12, 12}), SsimKind::conv, Tensor({12, 12})) ==
        1);
}

TEST_CASE("ssim of equal images is exactly 1") {
  const auto x = picture({3, 19, 31}, 3);
  for (const auto& [kind, ref] : kConventions) {
    CHECK(similarity(x, x, kind) == 1.0);
    CHECK(ssim(Var(x.cast<float>()), x.cast<float>(), kind).value().item() == 1.0f);
  }
}

TEST_CASE("ssim counts the pixels of the mask") {
  const Index H = 23, W = 26;
  const auto x = picture({2, 3, H, W}, 4), y = like(x, 5, 0.2), mask = holes(H, W, 6);
  for (const auto& [kind, ref] : kConventions) {
    CAPTURE(kind == SsimKind::conv);
    const double want = test::ssim_ref(x, y, mask.data(), 6, H, W, ref);
    CHECK(similarity(x, y, kind, mask) == doctest::Approx(want).epsilon(1e-12));
    CHECK(std::abs(want - similarity(x, y, kind)) > 1e-3);

    // every image with a mask of its own
    auto both = BasicTensor<double>::uninitialised({2, H, W});
    const auto other = holes(H, W, 7);
    std::copy_n(mask.data(), H * W, both.data());
    std::copy_n(other.data(), H * W, both.data() + H * W);
    test::SsimRefSum all;
    for (Index p = 0; p < 6; ++p) {
      const auto one = test::ssim_ref(x.data() + p * H * W, y.data() + p * H * W,
                                      both.data() + p / 3 * H * W, H, W, ref);
      all.sum += one.sum, all.pixels += one.pixels;
    }
    CHECK(similarity(x, y, kind, both) == doctest::Approx(all.sum / all.pixels).epsilon(1e-12));

    // what masked pixels hold does not matter
    auto odd = x.clone(), odd_y = y.clone();
    for (Index i = 0; i < odd.count(); ++i)
      if (mask[i % (H * W)] == 0) odd[i] = 7, odd_y[i] = std::numeric_limits<double>::quiet_NaN();
    BasicVar<double> v(odd, true), w(x, true);
    const auto s = ssim(v, odd_y, kind, mask), t = ssim(w, y, kind, mask);
    CHECK(s.value().item() == t.value().item());
    s.backward();
    t.backward();
    for (Index i = 0; i < odd.count(); ++i) {
      REQUIRE(v.grad()[i] == w.grad()[i]);
      if (mask[i % (H * W)] == 0) REQUIRE(v.grad()[i] == 0);
    }

    BasicVar<double> none(x, true);
    const auto nothing = ssim(none, y, kind, BasicTensor<double>({H, W}));
    CHECK(nothing.value().item() == 1);
    nothing.backward();
    for (const double g : none.grad().values()) REQUIRE(g == 0);
  }
}

TEST_CASE("ssim gradient") {
  const Index H = 13, W = 18;
  const auto x = picture({2, 2, H, W}, 8), y = like(x, 9, 0.15), mask = holes(H, W, 10);
  for (const auto& [kind, ref] : kConventions) {
    CAPTURE(kind == SsimKind::conv);
    const SsimKind k = kind;
    CHECK(gradcheck([&](auto& v) { return ssim(v[0], y, k); }, {x}));
    CHECK(gradcheck([&](auto& v) { return ssim(v[0], y, k, mask); }, {x}));
  }
  CHECK(gradcheck(
      [&](auto& v) {
        return ssim(v[0], picture({2, 3, 4}, 12), SsimKind::conv);
      },
      {picture({2, 3, 4}, 11)}));
}

TEST_CASE_TEMPLATE("ssim does not depend on the number of threads", T, float, double) {
  const auto x = picture({2, 37, 41}, 13).cast<T>(), y = picture({2, 37, 41}, 14).cast<T>();
  const auto mask = holes(37, 41, 15).cast<T>();
  for (const auto& [kind, ref] : kConventions) {
    BasicVar<T> one(x.clone(), true), two(x.clone(), true);
    set_threads(1);
    const auto a = ssim(one, y, kind, mask);
    a.backward();
    set_threads(2);
    const auto b = ssim(two, y, kind, mask);
    b.backward();
    set_threads(0);
    CHECK(a.value().item() == b.value().item());
    for (Index i = 0; i < x.count(); ++i) REQUIRE(one.grad()[i] == two.grad()[i]);
  }
}

TEST_CASE_TEMPLATE("ssim kernels of every instruction set agree with plain loops", T, float,
                   double) {
  const double tolerance = sizeof(T) == 4 ? 3e-5 : 1e-11;
  SsimTerms<T> terms{};
  for (Index r = 0; r <= kSsimRadius; ++r)
    terms.window[r] = static_cast<T>(0.2 - 0.03 * static_cast<double>(r));
  terms.covariance = T(1.25), terms.c1 = T(0.01), terms.c2 = T(0.02);
  const auto weight = [&](Index k) { return static_cast<double>(terms.window[std::abs(k)]); };
  for (const auto& kernels : test::kernel_variants<SsimKernels<T>>())
    for (const Index n : {1, 4, 16, 19, 37}) {
      CAPTURE(kernels.name);
      CAPTURE(n);
      const Index stride = n + 2 * kSsimSlack;
      const auto padded = [&](Index rows, std::uint64_t seed) {
        auto t = test::normal({rows, stride}, seed, 0.2).template cast<T>();
        for (T& v : t.values()) v += T(0.5);
        return t;
      };
      const auto row = [&](auto& t, Index r) { return t.data() + r * stride + kSsimSlack; };
      const auto x = padded(kSsimWindow, 20), y = padded(kSsimWindow, 21);
      std::vector<const T*> xs, ys;
      for (Index r = 0; r < kSsimWindow; ++r) xs.push_back(row(x, r)), ys.push_back(row(y, r));

      BasicTensor<T> filtered({5, stride}, T(-9));
      std::vector<T*> to;
      for (Index k = 0; k < 5; ++k) to.push_back(row(filtered, k));
      kernels.moments(terms, xs.data(), ys.data(), n, to.data());
      std::vector<T> single(static_cast<std::size_t>(n));
      kernels.down(terms, xs.data(), n, single.data());
      for (Index i = 0; i < n; ++i) {
        double want[5] = {};
        for (Index r = 0; r < kSsimWindow; ++r) {
          const double a = static_cast<double>(xs[static_cast<std::size_t>(r)][i]);
          const double b = static_cast<double>(ys[static_cast<std::size_t>(r)][i]);
          const double terms_of[5] = {a, b, a * a, b * b, a * b};
          for (int k = 0; k < 5; ++k) want[k] += weight(r - kSsimRadius) * terms_of[k];
        }
        for (Index k = 0; k < 5; ++k)
          REQUIRE(std::abs(static_cast<double>(row(filtered, k)[i]) - want[k]) < tolerance);
        REQUIRE(std::abs(static_cast<double>(single[static_cast<std::size_t>(i)]) - want[0]) <
                tolerance);
      }
      for (Index k = 0; k < 5; ++k) REQUIRE(row(filtered, k)[n] == T(-9));

      const auto inner = padded(5, 22);
      auto counts = padded(1, 23);
      for (Index i = 0; i < counts.count(); ++i) counts[i] = i % 3 == 0 ? T(0) : T(1);
      std::vector<const T*> from;
      for (Index k = 0; k < 5; ++k) from.push_back(row(inner, k));
      const auto across = [&](Index k, Index i) {
        double sum = 0;
        for (Index r = -kSsimRadius; r <= kSsimRadius; ++r)
          sum += weight(r) * static_cast<double>(row(inner, k)[i + r]);
        return sum;
      };
      BasicTensor<T> slopes({3, stride}, T(-9));
      std::vector<T*> slope_rows;
      for (Index k = 0; k < 3; ++k) slope_rows.push_back(row(slopes, k));
      double sums[2], again[2], want_sum = 0, want_count = 0;
      kernels.compare(terms, from.data(), row(counts, 0), n, slope_rows.data(), sums);
      kernels.compare(terms, from.data(), row(counts, 0), n, nullptr, again);
      for (Index i = 0; i < n; ++i) {
        const bool in = row(counts, 0)[i] != 0;
        double at[5];
        for (Index k = 0; k < 5; ++k) at[k] = across(k, i);
        const auto value = [&](double mx, double xx, double xy) {
          const double v = static_cast<double>(terms.covariance);
          const double c1 = static_cast<double>(terms.c1), c2 = static_cast<double>(terms.c2);
          const double my = at[1], yy = at[3];
          return (2 * mx * my + c1) * (2 * v * (xy - mx * my) + c2) /
                 ((mx * mx + my * my + c1) * (v * (xx - mx * mx + yy - my * my) + c2));
        };
        want_sum += in ? value(at[0], at[2], at[4]) : 0;
        want_count += in ? 1 : 0;
        const double h = 1e-5;
        const double slope[3] = {
            (value(at[0] + h, at[2], at[4]) - value(at[0] - h, at[2], at[4])) / (2 * h),
            (value(at[0], at[2] + h, at[4]) - value(at[0], at[2] - h, at[4])) / (2 * h),
            (value(at[0], at[2], at[4] + h) - value(at[0], at[2], at[4] - h)) / (2 * h)};
        for (Index k = 0; k < 3; ++k)
          REQUIRE(static_cast<double>(row(slopes, k)[i]) ==
                  doctest::Approx(in ? slope[k] : 0).epsilon(sizeof(T) == 4 ? 1e-3 : 1e-6));
      }
      CHECK(sums[0] == doctest::Approx(want_sum).epsilon(tolerance));
      CHECK(sums[1] == want_count);
      CHECK(again[0] == sums[0]);
      CHECK(row(slopes, 2)[n] == T(-9));

      auto d = padded(1, 24);
      const auto before = d.clone();
      kernels.gather(terms, from.data(), xs[0], ys[0], row(counts, 0), T(0.75), n, row(d, 0));
      for (Index i = 0; i < n; ++i) {
        const double add = 0.75 * (across(0, i) + 2 * static_cast<double>(xs[0][i]) * across(1, i) +
                                   static_cast<double>(ys[0][i]) * across(2, i));
        REQUIRE(std::abs(static_cast<double>(row(d, 0)[i] - row(before, 0)[i]) -
                         (row(counts, 0)[i] != 0 ? add : 0)) < tolerance);
      }
      CHECK(row(d, 0)[n] == row(before, 0)[n]);
    }
}

TEST_CASE("ssim refuses what does not fit") {
  const auto x = [](const Shape& s) { return BasicVar<double>(BasicTensor<double>(s)); };
  CHECK_THROWS_WITH_AS(ssim(x({3, 4, 5}), BasicTensor<double>({3, 4, 6}), SsimKind::conv),
                       "ssim: reference has shape [3,4,6], expected [C H W] with C=3 from x, H=4 "
                       "from x, W=5 from x",
                       ShapeError);
  CHECK_THROWS_WITH_AS(ssim(x({4, 5}), BasicTensor<double>({4, 5}), SsimKind::conv),
                       "ssim: x has shape [4,5], expected [C H W]", ShapeError);
  CHECK_THROWS_WITH_AS(ssim(x({3, 4, 5}), BasicTensor<double>({3, 4, 5}), SsimKind::conv,
                            BasicTensor<double>({5, 4})),
                       "ssim: mask has shape [5,4], expected [H W] with H=4 from x, W=5 from x",
                       ShapeError);
  CHECK_THROWS_WITH_AS(
      ssim(x({3, 10, 40}), BasicTensor<double>({3, 10, 40}), SsimKind::skimage),
      "ssim: x has shape [3,10,40], expected H and W of at least 11, the window; or SsimKind::conv",
      ShapeError);
  CHECK_THROWS_WITH_AS(ssim(x({0, 4, 5}), BasicTensor<double>({0, 4, 5}), SsimKind::conv),
                       "ssim: x has shape [0,4,5], expected at least one pixel", ShapeError);
}

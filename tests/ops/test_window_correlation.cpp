// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"
#include "satsurf/core/rng.h"
#include "satsurf/ops/window_correlation.h"
#include "satsurf/ops/window_correlation_kernels.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

#include "tests/gradcheck.h"
#include "tests/isa_variants.h"

using namespace satsurf;

namespace {

constexpr Index kRadius = ComparedWindow::kRadius;

/// Blotches and noise; some pixels do not count.
MaskedGrey image(Index H, Index W, std::uint64_t seed, bool holes) {
  Rng rng(seed);
  MaskedGrey out{Tensor({H, W}), Tensor({H, W}, 1.f)};
  for (Index i = 0; i < H * W; ++i) {
    const double x = static_cast<double>(i % W), y = static_cast<double>(i / W);
    out.grey[i] = static_cast<float>(0.5 + 0.2 * std::sin(0.7 * x + 0.2 * y) * std::cos(0.5 * y) +
                                     0.05 * rng.normal());
    if (holes && rng.uniform() < 0.01) out.valid[i] = 0.5f;
  }
  return out;
}

/// A bit more than a shift, with all ten terms.
Quadratic some_map(double shift) {
  Quadratic map;
  map.offset = {20, 15, 30};
  map.scale = {20, 15, 50};
  map.coeff[0] = {20 + shift, 20.3, 0.2, 6, 0.1, 0.05, 0.2, -0.1, 0.1, 0.3};
  map.coeff[1] = {15 - shift / 2, -0.3, 15.1, 2, 0.07, -0.02, 0.1, 0.2, -0.1, 0.2};
  return map;
}

/// As it is defined, in double.
double by_definition(const MaskedGrey& a, const MaskedGrey& b, const Quadratic& map,
                     const PixelBox& box, double z, Index x, Index y) {
  std::vector<double> va, vb;
  for (Index v = std::max(box.y0, y - kRadius); v <= std::min(box.y1 - 1, y + kRadius); ++v)
    for (Index u = std::max(box.x0, x - kRadius); u <= std::min(box.x1 - 1, x + kRadius); ++u) {
      const auto q = map(static_cast<double>(u), static_cast<double>(v), z);
      const double right = static_cast<double>(b.width() - 1),
                   bottom = static_cast<double>(b.height() - 1);
      if (a.valid[v * a.width() + u] < 1 || !(q[0] >= 0 && q[1] >= 0) || q[0] > right ||
          q[1] > bottom)
        continue;
      const Index p = std::min(static_cast<Index>(q[0]), b.width() - 2),
                  r = std::min(static_cast<Index>(q[1]), b.height() - 2), at = r * b.width() + p;
      if (b.valid[at] < 1) continue;
      const double fx = q[0] - static_cast<double>(p), fy = q[1] - static_cast<double>(r);
      const auto value = [&](Index k) { return static_cast<double>(b.grey[at + k]); };
      va.push_back(static_cast<double>(a.grey[v * a.width() + u]));
      vb.push_back((1 - fy) * ((1 - fx) * value(0) + fx * value(1)) +
                   fy * ((1 - fx) * value(b.width()) + fx * value(b.width() + 1)));
    }
  const double n = static_cast<double>(va.size());
  if (n < static_cast<double>(ComparedWindow::kWhole)) return -1;
  double ma = 0, mb = 0, saa = 0, sbb = 0, sab = 0;
  for (std::size_t i = 0; i < va.size(); ++i) ma += va[i] / n, mb += vb[i] / n;
  for (std::size_t i = 0; i < va.size(); ++i) {
    saa += (va[i] - ma) * (va[i] - ma), sbb += (vb[i] - mb) * (vb[i] - mb);
    sab += (va[i] - ma) * (vb[i] - mb);
  }
  if (std::min(saa, sbb) / n < static_cast<double>(ComparedWindow::kTexture)) return -1;
  return sab / std::sqrt(saa * sbb);
}

}  // namespace

TEST_CASE("window_correlation agrees with its definition") {
  const MaskedGrey a = image(40, 150, 1, true), b = image(37, 139, 2, true);
  MaskedGrey flat = b;
  for (Index i = 0; i < flat.grey.count(); ++i)
    if (i % flat.width() > 80) flat.grey[i] = 0.25f;
  for (const PixelBox& box : {PixelBox{0, 0, 150, 40}, PixelBox{3, 5, 99, 31},
                              PixelBox{60, 10, 70, 14}, PixelBox{10, 9, 110, 10}})
    for (const double shift : {0.0, -25.0, 90.0})
      for (const MaskedGrey* other : {&b, static_cast<const MaskedGrey*>(&flat)}) {
        const Quadratic map = some_map(shift);
        const double z = 37;
        const Tensor got = window_correlation(a, *other, map, box, z);
        REQUIRE(got.shape() == Shape{box.height(), box.width()});
        Index known = 0;
        for (Index y = 0; y < box.height(); ++y)
          for (Index x = 0; x < box.width(); ++x) {
            const double want = by_definition(a, *other, map, box, z, x + box.x0, y + box.y0);
            const double value = static_cast<double>(got[y * box.width() + x]);
            CAPTURE(x);
            CAPTURE(y);
            REQUIRE(value == doctest::Approx(want).epsilon(2e-3));
            known += want > -1 ? 1 : 0;
          }
        if (box.height() > 20 && shift == 0) CHECK(known > 200);
      }
}

TEST_CASE("window_correlation of an image with itself is 1 where there is texture") {
  MaskedGrey a = image(20, 30, 3, false);
  for (Index i = 0; i < a.grey.count(); ++i)
    if (i % 30 >= 15) a.grey[i] = 0.5f;
  Quadratic itself;
  itself.coeff[0][1] = itself.coeff[1][2] = 1;
  const Tensor c = window_correlation(a, a, itself, {0, 0, 30, 20}, 0);
  for (Index y = 0; y < 20; ++y)
    for (Index x = 0; x < 30; ++x) {
      CAPTURE(x);
      CAPTURE(y);
      // At the border windows are cut, and with a row or column less fewer than nine tenths count.
      const bool whole = x >= kRadius && y >= kRadius && x < 30 - kRadius && y < 20 - kRadius;
      if (!whole || x >= 15 + kRadius)
        CHECK(c[y * 30 + x] == -1.f);
      else
        CHECK(c[y * 30 + x] == doctest::Approx(1).epsilon(1e-3));
    }
}

TEST_CASE("window_correlation of what lies nowhere in the other image, and of little") {
  const MaskedGrey a = image(20, 30, 3, false);
  for (const double shift : {1e3, -1e9, 1e300, std::nan("")}) {
    Quadratic map = some_map(0);
    map.coeff[0][0] = shift;
    const Tensor c = window_correlation(a, a, map, {0, 0, 30, 20}, 40);
    for (Index i = 0; i < c.count(); ++i) REQUIRE(c[i] == -1.f);
  }
  CHECK(window_correlation(a, a, some_map(0), {5, 5, 5, 9}, 40).count() == 0);
  CHECK(window_correlation(a, a, some_map(0), {5, 5, 9, 5}, 40).count() == 0);
  for (const auto& [H, W] : {std::pair<Index, Index>{1, 1}, {1, 30}, {20, 1}}) {
    const MaskedGrey thin = image(H, W, 4, false);
    const Tensor c = window_correlation(a, thin, some_map(0), {0, 0, 30, 20}, 40);
    for (Index i = 0; i < c.count(); ++i) REQUIRE(std::abs(c[i]) <= 1.f);
  }
}

TEST_CASE("window_correlation says what does not fit") {
  const MaskedGrey a = image(20, 30, 3, false);
  CHECK_THROWS_WITH_AS(
      window_correlation(a, a, some_map(0), {0, 0, 31, 20}, 0),
      "window_correlation: the box is columns 0 to 31 and rows 0 to 20, expected a "
      "part of a [20,30]",
      ShapeError);
  CHECK_THROWS_AS(window_correlation(a, a, some_map(0), {-1, 0, 3, 20}, 0), ShapeError);
  CHECK_THROWS_AS(window_correlation(a, a, some_map(0), {9, 0, 3, 20}, 0), ShapeError);
  CHECK_THROWS_AS(window_correlation(a, {a.grey, Tensor({20, 29})}, some_map(0), {0, 0, 30, 20}, 0),
                  ShapeError);
}

TEST_CASE_TEMPLATE("the loops of window_correlation say the same in every instruction set", T,
                   float, double) {
  const Index n = 150, H = 37, W = 139;
  const auto a = test::normal({n}, 1).cast<T>(), b = test::normal({H, W}, 2).cast<T>();
  BasicTensor<T> a_valid({n}, T(1)), b_valid({H, W}, T(1));
  for (Index i = 0; i < n; i += 17) a_valid[i] = T(0.9);
  for (Index i = 0; i < H * W; i += 13) b_valid[i] = T(0);
  const WarpedRow<T> row{.n = n,
                         .a = a.data(),
                         .a_valid = a_valid.data(),
                         .H = H,
                         .W = W,
                         .b = b.data(),
                         .b_valid = b_valid.data(),
                         .t0 = -1,
                         .step = 0.02,
                         .u = {50, 47.3, 2.1},
                         .v = {17, 0.7, 0.9}};
  const Index size = kWindowSums * n;
  Index last_seen = -1;
  std::vector<BasicTensor<T>> first;
  for (const auto& k : test::kernel_variants<WindowCorrelationKernels<T>>()) {
    BasicTensor<T> products({kWindowSums, n}, T(7)), columns({n + 2 * kRadius}),
        sums({kWindowSums, n}), out({n});
    const Index seen = k.products(row, products.data());
    Index counted = 0;
    for (Index i = 0; i < n; ++i) counted += products[i] == 1 ? 1 : 0;
    CHECK(seen == counted);
    CHECK(seen > n / 2);
    CHECK(seen < n);
    if (last_seen >= 0) CHECK(seen == last_seen);
    last_seen = seen;
    std::vector<const T*> rows(static_cast<std::size_t>(kWindowSide), products.data());
    k.correlate(rows.data(), n, columns.data(), sums.data(), out.data());
    if (first.empty()) first = {products, out};
    for (Index i = 0; i < size; ++i)
      REQUIRE(products[i] == doctest::Approx(first[0][i]).epsilon(1e-3));
    for (Index i = 0; i < n; ++i) REQUIRE(out[i] == doctest::Approx(first[1][i]).epsilon(1e-3));
  }
}

TEST_CASE("window_products are sums of products, and unknown where a pixel is") {
  const Index W = 200, H = 9;
  auto image = test::normal({H, W}, 1).cast<float>();
  image[3 * W + 150] = std::nanf("");
  for (const Index side : {1, 3, 9})
    for (const Index count : {1, 5, 15, 16, 17, 40, 64, 100, 185}) {
      CAPTURE(side);
      CAPTURE(count);
      const auto weights = test::normal({side, side}, 2).cast<float>();
      for (const auto& k : test::kernel_variants<WindowCorrelationKernels<float>>()) {
        std::vector<float> out(static_cast<std::size_t>(count) + 1, 7.f);
        k.window_products(weights.data(), side, image.data() + 2, W, count, out.data());
        CHECK(out.back() == 7.f);
        for (Index i = 0; i < count; ++i) {
          double want = 0;
          for (Index v = 0; v < side; ++v)
            for (Index u = 0; u < side; ++u)
              want += static_cast<double>(weights[v * side + u]) *
                      static_cast<double>(image[v * W + u + 2 + i]);
          const double got = static_cast<double>(out[static_cast<std::size_t>(i)]);
          if (std::isnan(want))
            REQUIRE(std::isnan(got));
          else
            REQUIRE(got == doctest::Approx(want).epsilon(1e-4));
        }
      }
    }
}

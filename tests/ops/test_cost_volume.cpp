// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/ops/cost_volume.h"
#include "satsurf/ops/cost_volume_kernels.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "tests/gradcheck.h"
#include "tests/isa_variants.h"
#include "tests/ref/cost_volume_ref.h"

using namespace satsurf;
using test::gradcheck;
using test::normal;
using test::plane_sweep_variance_ref;

namespace {

struct Scene {
  BasicTensor<double> features, heights, valid;
  std::vector<Quadratic> maps;
  Index reference = 0;
};

/// Cameras whose parallax carries part of the samples over the border, with all second-order terms
/// in use, and some invalid pixels.
Scene scene(Index N, Index C, Index D, Index H, Index W, Index reference, std::uint64_t seed) {
  Rng rng(seed);
  Scene s;
  s.reference = reference;
  s.features = normal({N, C, H, W}, seed + 1);
  s.heights = BasicTensor<double>({D, H, W});
  for (Index i = 0; i < s.heights.count(); ++i)
    s.heights[i] =  // the same number in float and double
        static_cast<float>(200 + 10 * static_cast<double>(i / (H * W)) + rng.uniform(-2, 2));
  const double w = static_cast<double>(W), h = static_cast<double>(H);
  for (Index j = 0; j < N; ++j) {
    Quadratic q;
    q.offset = {w / 2, h / 2, 200 + 5 * static_cast<double>(D)};
    q.scale = {w / 2 + 1, h / 2 + 1, 5 * static_cast<double>(D) + 1};
    for (std::size_t k = 0; k < 2; ++k) {
      const double size = k == 0 ? w : h;
      if (size == 1) continue;  // on the only row or column
      for (std::size_t m = 4; m < 10; ++m) q.coeff[k][m] = 0.02 * size * rng.uniform(-1, 1);
      q.coeff[k][0] = size / 2 - 0.5 + rng.uniform(-0.5, 0.5);
      q.coeff[k][1 + k] = 0.45 * size * rng.uniform(0.9, 1.1);
      q.coeff[k][2 - k] = 0.05 * size * rng.uniform(-1, 1);
      q.coeff[k][3] = 0.5 * size * rng.uniform(-1, 1);
    }
    s.maps.push_back(q);
  }
  s.valid = BasicTensor<double>({N, H, W}, 1.0);
  for (double& v : s.valid.values())
    if (rng.chance(0.15)) v = 0;
  return s;
}

template <class T>
BasicTensor<T> variance(const Scene& s, bool masked, bool include_reference) {
  return plane_sweep_variance(BasicVar<T>(s.features.cast<T>()), s.reference, s.maps,
                              s.heights.cast<T>(), masked ? s.valid.cast<T>() : BasicTensor<T>{},
                              {.include_reference = include_reference})
      .value();
}

double worst_difference(const BasicTensor<double>& a, const BasicTensor<double>& b) {
  REQUIRE(a.shape() == b.shape());
  double worst = 0;
  for (Index i = 0; i < a.count(); ++i) {
    const double e = std::abs(a[i] - b[i]) / std::max(1.0, std::abs(b[i]));
    if (!(e <= worst)) worst = e;
  }
  return worst;
}

Quadratic shift(double dx, double dy, double per_height) {
  Quadratic q;
  q.coeff[0] = {dx, 1, 0, per_height};
  q.coeff[1] = {dy, 0, 1, 0};
  return q;
}

}  // namespace

TEST_CASE("plane_sweep_variance agrees with its definition") {
  // views, channels, hypotheses, height, width, reference
  const std::vector<std::array<Index, 6>> cases = {
      {3, 8, 3, 7, 9, 1},  {3, 5, 2, 6, 70, 0},  {2, 3, 4, 5, 6, 1},
      {4, 17, 2, 5, 8, 2}, {3, 1, 2, 1, 7, 2},   {3, 2, 3, 6, 1, 0},
      {2, 4, 1, 1, 1, 0},  {5, 32, 2, 4, 67, 3}, {3, 16, 2, 5, 6, 0}};
  for (const auto& [N, C, D, H, W, reference] : cases)
    for (const bool masked : {false, true})
      for (const bool include : {false, true}) {
        CAPTURE(N);
        CAPTURE(C);
        CAPTURE(W);
        CAPTURE(masked);
        CAPTURE(include);
        const Scene s = scene(N, C, D, H, W, reference, static_cast<std::uint64_t>(40 + C));
        const auto want =
            plane_sweep_variance_ref(s.features, reference, s.maps, s.heights,
                                     masked ? s.valid : BasicTensor<double>{}, include);
        CHECK(worst_difference(variance<double>(s, masked, include), want) < 1e-12);
        CHECK(worst_difference(variance<float>(s, masked, include).cast<double>(), want) < 1e-4);
      }
}

TEST_CASE("the scenes cover zero, one and more source views per sample") {
  const Scene s = scene(3, 1, 3, 7, 9, 1, 48);
  Index zeros = 0;
  const auto with = variance<double>(s, true, true), without = variance<double>(s, true, false);
  for (Index i = 0; i < with.count(); ++i) zeros += with[i] == 0 ? 1 : 0;
  Index single = 0;
  for (Index i = 0; i < with.count(); ++i) single += with[i] != 0 && without[i] == 0 ? 1 : 0;
  CHECK(zeros > 5);
  CHECK(single > 5);
  CHECK(zeros + single < with.count() - 5);
}

TEST_CASE("plane_sweep_variance gradient") {
  // More rows than fit two bands, more pixels than one tile, channels that are no multiple of any
  // vector.
  const std::vector<std::array<Index, 6>> cases = {{3, 2, 2, 7, 6, 1}, {2, 3, 2, 3, 5, 0},
                                                   {4, 5, 2, 4, 3, 2}, {3, 2, 2, 1, 5, 0},
                                                   {3, 2, 3, 6, 1, 2}, {3, 2, 2, 3, 66, 2}};
  for (const auto& [N, C, D, H, W, reference] : cases)
    for (const bool include : {false, true}) {
      CAPTURE(N);
      CAPTURE(W);
      CAPTURE(include);
      const Scene s = scene(N, C, D, H, W, reference, static_cast<std::uint64_t>(70 + H));
      test::GradcheckOptions opt;
      if (N == 2 && !include) opt.zero_ok = {0};  // a single view has no variance
      CHECK(gradcheck(
          [&](const test::DoubleVars& v) {
            return plane_sweep_variance(v[0], s.reference, s.maps, s.heights, s.valid,
                                        {.include_reference = include});
          },
          {s.features}, opt));
    }
}

namespace {

/// The best pair's channels by their definition (ops/cost_volume.h), of one pixel and hypothesis:
/// four distances and the share of the sources that see the point.
std::array<double, 5> best_pair_ref(const Scene& s, bool masked, Index d, Index y, Index x) {
  const Index N = s.features.dim(0), C = s.features.dim(1), H = s.features.dim(2),
              W = s.features.dim(3);
  std::array<double, 5> best{};
  double least = INFINITY, count = 0;
  for (Index j = 0; j < N; ++j) {
    if (j == s.reference) continue;
    const auto [u, v] = s.maps[static_cast<std::size_t>(j)](
        static_cast<double>(x), static_cast<double>(y), s.heights[(d * H + y) * W + x]);
    if (!(u >= 0 && u <= static_cast<double>(W - 1) && v >= 0 && v <= static_cast<double>(H - 1)))
      continue;
    const auto near_x = static_cast<Index>(std::floor(u + 0.5)),
               near_y = static_cast<Index>(std::floor(v + 0.5));
    if (masked && s.valid[(j * H + near_y) * W + near_x] == 0) continue;
    ++count;
    std::array<double, 4> distance{};
    const auto x0 = std::min<Index>(static_cast<Index>(u), std::max<Index>(W - 2, 0)),
               y0 = std::min<Index>(static_cast<Index>(v), std::max<Index>(H - 2, 0));
    const double fx = u - static_cast<double>(x0), fy = v - static_cast<double>(y0);
    for (Index c = 0; c < C; ++c) {
      const auto at = [&](Index row, Index col) {
        return s.features[((j * C + c) * H + std::min(row, H - 1)) * W + std::min(col, W - 1)];
      };
      const double f = (1 - fy) * ((1 - fx) * at(y0, x0) + fx * at(y0, x0 + 1)) +
                       fy * ((1 - fx) * at(y0 + 1, x0) + fx * at(y0 + 1, x0 + 1)),
                   own = s.features[((s.reference * C + c) * H + y) * W + x];
      distance[static_cast<std::size_t>(c % 4)] +=
          4.0 / static_cast<double>(C) * (own - f) * (own - f);
    }
    const double total = distance[0] + distance[1] + distance[2] + distance[3];
    if (!(total < least)) continue;
    least = total;
    std::ranges::copy(distance, best.begin());
  }
  best[4] = count / static_cast<double>(N - 1);
  return best;
}

}  // namespace

TEST_CASE("the best pair's channels agree with their definition, the others stay as they are") {
  const std::vector<std::array<Index, 6>> cases = {{3, 8, 3, 7, 9, 1}, {3, 5, 2, 6, 70, 0},
                                                   {2, 3, 4, 5, 6, 1}, {4, 17, 2, 5, 8, 2},
                                                   {3, 1, 2, 1, 7, 2}, {5, 32, 2, 4, 67, 3}};
  for (const auto& [N, C, D, H, W, reference] : cases)
    for (const bool masked : {false, true})
      for (const bool include : {false, true}) {
        CAPTURE(N);
        CAPTURE(C);
        CAPTURE(masked);
        const Scene s = scene(N, C, D, H, W, reference, static_cast<std::uint64_t>(60 + C));
        const auto plain = variance<double>(s, masked, include);
        const auto with = [&]<class T>(T) {
          return plane_sweep_variance(BasicVar<T>(s.features.cast<T>()), s.reference, s.maps,
                                      s.heights.cast<T>(),
                                      masked ? s.valid.cast<T>() : BasicTensor<T>{},
                                      {.include_reference = include, .best_pair = true})
              .value()
              .template cast<double>();
        };
        for (const auto& [v, within] : {std::pair(with(0.0), 1e-12), {with(0.f), 1e-4}}) {
          REQUIRE(v.shape() == Shape{C + kPairChannels, D, H, W});
          double worst = 0;
          for (Index i = 0; i < plain.count(); ++i)
            worst = std::max(worst, std::abs(v[i] - plain[i]) / std::max(1.0, plain[i]));
          for (Index d = 0; d < D; ++d)
            for (Index y = 0; y < H; ++y)
              for (Index x = 0; x < W; ++x) {
                const auto want = best_pair_ref(s, masked, d, y, x);
                for (Index k = 0; k < kPairChannels; ++k)
                  worst = std::max(worst, std::abs(v[(((C + k) * D + d) * H + y) * W + x] -
                                                   want[static_cast<std::size_t>(k)]) /
                                              std::max(1.0, want[static_cast<std::size_t>(k)]));
              }
          CHECK(worst < within);
        }
      }
}

TEST_CASE("without another view there is neither variance nor a pair") {
  const Scene s = scene(1, 6, 3, 5, 70, 0, 12);
  const auto check = [&]<class T>(T) {
    const BasicVar<T> f(s.features.cast<T>(), true);
    const BasicVar<T> v = plane_sweep_variance(f, 0, s.maps, s.heights.cast<T>(), s.valid.cast<T>(),
                                               {.best_pair = true});
    REQUIRE(v.shape() == Shape{6 + kPairChannels, 3, 5, 70});
    for (Index i = 0; i < v.count(); ++i) REQUIRE(v.value()[i] == 0);
    v.backward(BasicTensor<T>(v.shape(), T(1)));
    for (Index i = 0; i < f.count(); ++i) REQUIRE(f.grad()[i] == 0);
  };
  check(0.F);
  check(0.0);
}

TEST_CASE("the best pair's gradient") {
  const std::vector<std::array<Index, 6>> cases = {
      {3, 2, 2, 7, 6, 1}, {2, 3, 2, 3, 5, 0}, {4, 5, 2, 4, 3, 2}, {3, 2, 2, 3, 66, 2}};
  for (const auto& [N, C, D, H, W, reference] : cases)
    for (const bool include : {false, true}) {
      CAPTURE(N);
      CAPTURE(W);
      const Scene s = scene(N, C, D, H, W, reference, static_cast<std::uint64_t>(80 + H));
      CHECK(gradcheck(
          [&](const test::DoubleVars& v) {
            return plane_sweep_variance(v[0], s.reference, s.maps, s.heights, s.valid,
                                        {.include_reference = include, .best_pair = true});
          },
          {s.features}));
    }
}

TEST_CASE("a plane sweep by rows gives the rows of the volume") {
  for (const bool best_pair : {false, true}) {
    const Scene s = scene(3, 6, 4, 11, 70, 1, 8);
    const auto features = s.features.cast<float>(), heights = s.heights.cast<float>(),
               valid = s.valid.cast<float>();
    const SweepOptions options{.include_reference = true, .best_pair = best_pair};
    const Tensor whole =
        plane_sweep_variance(Var(features), s.reference, s.maps, heights, valid, options).value();
    const PlaneSweep<float> sweep(features, s.reference, s.maps, heights, valid, options);
    REQUIRE(sweep.shape() == whole.shape());
    const Index planes = whole.dim(0) * 4, W = 70, first = 3, last = 8;
    Tensor band({planes, last - first + 2, W}, -1.0f);  // a row more on either side stays as it is
    sweep.rows(first, last, band.data() + W, (last - first + 2) * W);
    for (Index k = 0; k < planes; ++k)
      for (Index y = first - 1; y <= last; ++y)
        for (Index x = 0; x < W; ++x) {
          const float there = band[(k * (last - first + 2) + y - first + 1) * W + x];
          REQUIRE(there == (y < first || y == last ? -1.0f : whole[(k * 11 + y) * W + x]));
        }
  }
  CHECK_THROWS_AS(PlaneSweep<float>(Tensor({2, 3, 4, 4}), 2, {}, Tensor({1, 4, 4}), {}),
                  ShapeError);
}

TEST_CASE("plane_sweep_variance by hand") {
  // One row of three pixels; view 1 is shifted by half a pixel, view 2 lies outside at the second
  // height.
  const BasicVar<double> f(BasicTensor<double>::from({3, 1, 1, 3}, {1, 2, 3, 10, 20, 40, 5, 5, 5}));
  const std::vector<Quadratic> maps = {Quadratic{}, shift(0.5, 0, 0), shift(0, 0, 9)};
  const auto heights = BasicTensor<double>::from({2, 1, 3}, {0, 0, 0, 1, 1, 1});
  const auto v = plane_sweep_variance(f, 0, maps, heights, {}).value();
  // h = 0: {1, 15, 5}, {2, 30, 5}, {3, -, 5};  h = 1: {1, 15}, {2, 30}, {3}
  const double want[] = {
      (1 + 225 + 25) / 3.0 - 49, (4 + 900 + 25) / 3.0 - 37.0 * 37 / 9, 1, 49, 196, 0};
  for (Index i = 0; i < 6; ++i) CHECK(v[i] == doctest::Approx(want[i]).epsilon(1e-14));

  SUBCASE("the nearest pixel decides whether a sample is valid, halves rounded up") {
    const auto valid = BasicTensor<double>::from({3, 1, 3}, {1, 1, 1, 1, 0, 1, 1, 1, 1});
    const auto m = plane_sweep_variance(f, 0, maps, heights, valid).value();
    CHECK(m[0] == doctest::Approx(4));  // 0.5 -> 1, invalid: {1, 5}
    CHECK(m[1] == doctest::Approx((4 + 900 + 25) / 3.0 - 37.0 * 37 / 9));  // 1.5 -> 2
    CHECK(m[3] == 0);
  }
  SUBCASE("a reference that is invalid still counts") {
    const auto valid = BasicTensor<double>::from({3, 1, 3}, {0, 0, 0, 1, 1, 1, 1, 1, 1});
    CHECK(plane_sweep_variance(f, 0, maps, heights, valid).value()[0] == doctest::Approx(want[0]));
  }
}

TEST_CASE("plane_sweep_variance keeps its precision far from zero") {
  Scene s = scene(3, 8, 2, 5, 6, 0, 5);
  const auto want = plane_sweep_variance_ref(s.features, 0, s.maps, s.heights, {}, true);
  for (double& f : s.features.values()) f += 100;
  CHECK(worst_difference(variance<float>(s, false, true).cast<double>(), want) < 1e-4);
}

TEST_CASE("heights that are not numbers count no source view") {
  Scene s = scene(3, 2, 1, 3, 4, 0, 6);
  const double bad[] = {std::numeric_limits<double>::quiet_NaN(),
                        std::numeric_limits<double>::infinity(),
                        -std::numeric_limits<double>::infinity(), 1e30};
  for (Index i = 0; i < 12; ++i) s.heights[i] = bad[i % 4];
  const auto v = variance<float>(s, true, true);
  for (Index i = 0; i < v.count(); ++i) CHECK(v[i] == 0);
}

TEST_CASE("plane_sweep_variance gives the same bits for any number of threads") {
  const Scene s = scene(3, 9, 3, 37, 41, 1, 8);
  for (const bool best_pair : {false, true}) {
    CAPTURE(best_pair);
    const auto run = [&](int threads) {
      set_threads(threads);
      const Var f(s.features.cast<float>(), true);
      const Var v = plane_sweep_variance(f, 1, s.maps, s.heights.cast<float>(),
                                         s.valid.cast<float>(), {.best_pair = best_pair});
      Rng rng(9);
      v.backward(normal_tensor<float>(v.shape(), rng));
      set_threads(0);
      return std::pair(v.value(), f.grad());
    };
    const auto one = run(1), two = run(2), four = run(4);
    for (const auto& other : {two, four}) {
      for (Index i = 0; i < one.first.count(); ++i) REQUIRE(one.first[i] == other.first[i]);
      for (Index i = 0; i < one.second.count(); ++i) REQUIRE(one.second[i] == other.second[i]);
    }
  }
}

namespace {

template <class T>
struct Swept {
  BasicTensor<T> volume, gradient;
};

/// What plane_sweep_variance does, one row after the other, with kernels of one's choice. Scratch
/// begins as NaN, which would be seen.
template <class T>
Swept<T> sweep(const SweepKernels<T>& kernels, const Scene& s, bool include, bool best_pair,
               const BasicTensor<T>& g) {
  const Index N = s.features.dim(0), C = s.features.dim(1), H = s.features.dim(2),
              W = s.features.dim(3), D = s.heights.dim(0), J = N - 1, P = H * W,
              Cs = C <= 4   ? 4
                   : C <= 8 ? 8
                            : (C + 15) / 16 * 16;
  const auto features = s.features.cast<T>(), heights = s.heights.cast<T>(),
             valid = s.valid.cast<T>();
  const auto scratch = [](Index count) {
    return BasicTensor<T>({count}, std::numeric_limits<T>::quiet_NaN());
  };
  BasicTensor<T> pixels = scratch(N * P * Cs), tile = scratch(kSweepTile * Cs),
                 reference_tile = scratch(kSweepTile * Cs), samples = scratch(J * Cs),
                 pair_tile = scratch(kSweepTile * kPairStride), sums = scratch(J * kDistanceLanes),
                 distances = scratch(J * kSweepTile * kDistanceParts);
  for (Index r = 0; r < N * H; ++r)
    kernels.to_pixels(features.data() + (r / H * C * H + r % H) * W, P, W, C, Cs,
                      pixels.data() + r * W * Cs);
  std::vector<Index> views;
  for (Index j = 0; j < N; ++j)
    if (j != s.reference) views.push_back(j);
  std::vector<const T*> sources, masks;
  for (const Index j : views) {
    sources.push_back(pixels.data() + j * P * Cs);
    masks.push_back(valid.data() + j * P);
  }
  const auto count = static_cast<std::size_t>(J);
  std::vector<SweepMap> maps(count);
  std::vector<SweepLines<T>> lines(count);
  std::vector<SweepTaps<T>> taps(count);
  std::vector<std::int8_t> best(static_cast<std::size_t>(D * P));
  SweepRow<T> row{.H = H,
                  .W = W,
                  .C = C,
                  .Cs = Cs,
                  .D = D,
                  .J = J,
                  .maps = maps.data(),
                  .sources = sources.data(),
                  .valid = masks.data(),
                  .reference = nullptr,
                  .reference_counts = include ? T(1) : T(0),
                  .heights = nullptr,
                  .plane = P,
                  .best = nullptr,
                  .lines = lines.data(),
                  .taps = taps.data(),
                  .tile = tile.data(),
                  .reference_tile = reference_tile.data(),
                  .samples = samples.data(),
                  .pair_tile = pair_tile.data(),
                  .sums = sums.data(),
                  .distances = distances.data()};
  const auto at_row = [&](Index y) {
    for (std::size_t j = 0; j < count; ++j) {
      const Quadratic& q = s.maps[static_cast<std::size_t>(views[j])];
      const double b = (static_cast<double>(y) - q.offset[1]) / q.scale[1];
      maps[j] = {1 / q.scale[0], -q.offset[0] / q.scale[0], 1 / q.scale[2], q.offset[2], {}, {}};
      for (std::size_t k = 0; k < 2; ++k) {
        const auto& c = q.coeff[k];
        double* to = k == 0 ? maps[j].u : maps[j].v;
        to[0] = c[0] + b * (c[2] + b * c[7]), to[1] = c[1] + b * c[5], to[2] = c[4];
        to[3] = c[3] + b * c[8], to[4] = c[6], to[5] = c[9];
      }
    }
    row.reference = pixels.data() + (s.reference * H + y) * W * Cs;
    row.heights = heights.data() + y * W;
    if (best_pair) row.best = best.data() + y * W;
  };
  Swept<T> out{BasicTensor<T>({C + (best_pair ? kPairChannels : 0), D, H, W}),
               BasicTensor<T>({N, C, H, W})};
  std::vector<std::int32_t> touched(2 * count);
  for (Index y = 0; y < H; ++y) {
    at_row(y);
    kernels.forward(row, out.volume.data() + y * W, touched.data());
    for (std::size_t j = 0; j < count; ++j)
      CHECK((
          touched[2 * j + 1] == -1 ||
          (touched[2 * j] >= 0 && touched[2 * j] <= touched[2 * j + 1] && touched[2 * j + 1] < H)));
  }
  BasicTensor<T> partial({J, H, W * Cs});
  std::vector<T*> d_sources;
  for (Index j = 0; j < J; ++j) d_sources.push_back(partial.data() + j * P * Cs);
  const std::vector<std::int32_t> first(count);
  for (Index y = 0; y < H; ++y) {
    at_row(y);
    kernels.backward(row, g.data() + y * W, out.gradient.data() + (s.reference * C * H + y) * W,
                     d_sources.data(), first.data());
  }
  for (Index j = 0; j < J; ++j)
    for (Index y = 0; y < H; ++y) {
      const T* const add = d_sources[static_cast<std::size_t>(j)] + y * W * Cs;
      kernels.add_rows(&add, 1, W, C, Cs,
                       out.gradient.data() + (views[static_cast<std::size_t>(j)] * C * H + y) * W,
                       P, tile.data());
    }
  return out;
}

}  // namespace

TEST_CASE_TEMPLATE("sweep kernels of every instruction set", T, float, double) {
  const double tolerance = std::is_same_v<T, float> ? 2e-4 : 1e-11;
  // one, two and three sources, channels of every stride, more pixels than a tile
  const std::vector<std::array<Index, 6>> cases = {{2, 3, 4, 5, 66, 1},
                                                   {3, 5, 2, 6, 70, 0},
                                                   {3, 16, 2, 5, 9, 2},
                                                   {4, 17, 2, 5, 8, 2},
                                                   {4, 32, 2, 4, 67, 3}};
  for (const auto& [N, C, D, H, W, reference] : cases)
    for (const bool include : {false, true})
      for (const bool best_pair : {false, true}) {
        const Scene s = scene(N, C, D, H, W, reference, static_cast<std::uint64_t>(90 + C));
        const BasicVar<double> f(s.features, true);
        const BasicVar<double> v =
            plane_sweep_variance(f, reference, s.maps, s.heights, s.valid,
                                 {.include_reference = include, .best_pair = best_pair});
        const auto g = normal(v.shape(), 3);
        v.backward(g);
        const auto oracle =
            plane_sweep_variance_ref(s.features, reference, s.maps, s.heights, s.valid, include);
        for (const auto& kernels : test::kernel_variants<SweepKernels<T>>()) {
          CAPTURE(kernels.name);
          CAPTURE(N);
          CAPTURE(C);
          CAPTURE(include);
          CAPTURE(best_pair);
          const Swept<T> got = sweep<T>(kernels, s, include, best_pair, g.cast<T>());
          CHECK(worst_difference(got.volume.template cast<double>(), v.value()) < tolerance);
          CHECK(worst_difference(got.gradient.template cast<double>(), f.grad()) < tolerance);
          for (Index i = 0; i < oracle.count(); ++i)
            REQUIRE(std::abs(static_cast<double>(got.volume[i]) - oracle[i]) <=
                    tolerance * std::max(1.0, oracle[i]));
        }
      }
}

TEST_CASE("plane_sweep_variance adds to gradients that are already there") {
  const Scene s = scene(3, 2, 2, 5, 4, 1, 10);
  const auto grad = [&](int times) {
    const BasicVar<double> f(s.features, true);
    for (int k = 0; k < times; ++k) {
      const auto v = plane_sweep_variance(f, 1, s.maps, s.heights, s.valid);
      v.backward(BasicTensor<double>(v.shape(), 1.0));
    }
    return f.grad();
  };
  const auto once = grad(1), twice = grad(2);
  for (Index i = 0; i < once.count(); ++i) CHECK(twice[i] == doctest::Approx(2 * once[i]));
}

TEST_CASE("plane_sweep_variance refuses") {
  const Scene s = scene(3, 2, 2, 5, 4, 1, 11);
  const BasicVar<double> f(s.features);
  const auto call = [&](Index reference, std::size_t maps, const BasicTensor<double>& heights,
                        const BasicTensor<double>& valid) {
    const std::vector<Quadratic> some(s.maps.begin(),
                                      s.maps.begin() + static_cast<std::ptrdiff_t>(maps));
    return plane_sweep_variance(f, reference, some, heights, valid);
  };
  CHECK_THROWS_WITH_AS(call(3, 3, s.heights, {}),
                       "plane_sweep_variance: reference is 3, expected one of 3 views", ShapeError);
  CHECK_THROWS_WITH_AS(call(-1, 3, s.heights, {}),
                       "plane_sweep_variance: reference is -1, expected one of 3 views",
                       ShapeError);
  CHECK_THROWS_WITH_AS(call(0, 2, s.heights, {}),
                       "plane_sweep_variance: 2 maps, expected one for each of 3 views",
                       ShapeError);
  CHECK_THROWS_WITH_AS(
      call(0, 3, BasicTensor<double>({2, 5, 3}), {}),
      "plane_sweep_variance: heights has shape [2,5,3], expected [D H W] with H=5 from features, "
      "W=4 from features",
      ShapeError);
  CHECK_THROWS_WITH_AS(
      call(0, 3, s.heights, BasicTensor<double>({2, 5, 4})),
      "plane_sweep_variance: valid has shape [2,5,4], expected [N H W] with N=3 from features, H=5 "
      "from features, W=4 from features",
      ShapeError);
}

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"
#include "satsurf/core/isa.h"
#include "satsurf/core/parallel.h"
#include "satsurf/ops/conv/conv.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "tests/gradcheck.h"
#include "tests/isa_variants.h"
#include "tests/ref/conv_ref.h"
#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::test;

namespace {

struct Case {
  const char* name;
  Index B, C, O;
  std::array<Index, 3> x, kernel, stride, padding;
};

// Odd sizes, single pixels, channel counts that fill no tile, rows shorter and longer than any
// vector, and the strides and kernels the network uses.
const std::vector<Case> kCases = {
    {"3x3x3", 2, 3, 5, {4, 5, 7}, {3, 3, 3}, {1, 1, 1}, {1, 1, 1}},
    {"3x3x3, all planes beyond one row", 1, 2, 8, {3, 9, 67}, {3, 3, 3}, {1, 1, 1}, {1, 1, 1}},
    {"3x3x3, one output", 2, 9, 1, {5, 7, 18}, {3, 3, 3}, {1, 1, 1}, {1, 1, 1}},
    {"3x3x3 down", 2, 3, 11, {6, 8, 10}, {3, 3, 3}, {2, 2, 2}, {1, 1, 1}},
    {"3x3x3 down, odd", 1, 5, 6, {5, 7, 35}, {3, 3, 3}, {2, 2, 2}, {1, 1, 1}},
    {"uneven kernel and strides", 2, 3, 4, {7, 9, 11}, {2, 3, 4}, {3, 2, 1}, {0, 2, 1}},
    {"stride beyond the kernel", 1, 2, 3, {7, 8, 9}, {2, 1, 2}, {3, 2, 3}, {0, 0, 0}},
    {"padding beyond the kernel", 1, 2, 3, {2, 3, 2}, {2, 3, 3}, {1, 1, 2}, {3, 4, 4}},
    {"one voxel", 3, 4, 2, {1, 1, 1}, {3, 3, 3}, {1, 1, 1}, {1, 1, 1}},
    {"one voxel down", 1, 4, 2, {1, 1, 1}, {3, 3, 3}, {2, 2, 2}, {1, 1, 1}},
    {"2D 3x3", 3, 3, 8, {1, 13, 17}, {1, 3, 3}, {1, 1, 1}, {0, 1, 1}},
    {"2D 3x3, wide", 1, 4, 10, {1, 5, 130}, {1, 3, 3}, {1, 1, 1}, {0, 1, 1}},
    {"2D 4x4 down", 2, 5, 7, {1, 12, 18}, {1, 4, 4}, {1, 2, 2}, {0, 1, 1}},
    {"2D 1x1", 2, 19, 13, {1, 6, 11}, {1, 1, 1}, {1, 1, 1}, {0, 0, 0}},
    {"2D 1x1, every second pixel", 1, 9, 17, {1, 7, 12}, {1, 1, 1}, {1, 2, 2}, {0, 0, 0}},
    {"2D 1x1, several stretches", 1, 70, 20, {1, 9, 50}, {1, 1, 1}, {1, 1, 1}, {0, 0, 0}},
    // outputs that go where they belong at once: in whole vectors, or with channels in the lanes
    {"1x1 of whole vectors", 2, 6, 13, {3, 5, 16}, {1, 1, 1}, {1, 1, 1}, {0, 0, 0}},
    {"2D 1x1 of joined rows", 2, 9, 17, {1, 12, 24}, {1, 1, 1}, {1, 1, 1}, {0, 0, 0}},
    {"down to a vector of outputs", 1, 3, 16, {4, 6, 32}, {3, 3, 3}, {2, 2, 2}, {1, 1, 1}},
    {"down to more, odd", 2, 2, 21, {3, 5, 63}, {3, 3, 3}, {2, 2, 2}, {1, 1, 1}},
    {"2D down, left out columns", 1, 3, 34, {1, 9, 50}, {1, 4, 3}, {1, 3, 2}, {0, 1, 0}},
    {"2D many channels", 1, 35, 12, {1, 7, 9}, {1, 3, 3}, {1, 1, 1}, {0, 1, 1}},
    {"2D tall enough for several chunks", 1, 33, 2, {1, 90, 70}, {1, 3, 3}, {1, 1, 1}, {0, 1, 1}},
    // enough outputs for rows to be mixed, see ops/conv/winograd.h
    {"mixed rows", 2, 5, 11, {4, 13, 35}, {3, 3, 3}, {1, 1, 1}, {1, 1, 1}},
    {"mixed rows, one output, no padding", 1, 9, 1, {6, 21, 20}, {3, 3, 3}, {1, 1, 1}, {0, 0, 0}},
    {"mixed rows, short ones", 3, 2, 3, {9, 19, 3}, {3, 3, 3}, {1, 1, 1}, {1, 1, 1}},
    {"mixed rows of a narrow kernel", 1, 3, 8, {2, 40, 17}, {2, 3, 1}, {1, 1, 1}, {0, 1, 0}},
    {"mixed rows, wide padding", 1, 2, 4, {3, 16, 33}, {1, 3, 4}, {1, 1, 1}, {1, 3, 2}},
    {"mixed rows, every second plane", 1, 4, 9, {7, 18, 50}, {3, 3, 3}, {2, 1, 1}, {1, 1, 1}},
    {"mixed rows 2D, several chunks", 1, 34, 16, {1, 91, 66}, {1, 3, 3}, {1, 1, 1}, {0, 1, 1}},
    {"3D several chunks and planes", 1, 9, 3, {4, 41, 65}, {3, 3, 3}, {1, 2, 2}, {1, 1, 1}},
};

conv::Geometry geometry(const Case& c) {
  conv::Geometry g{.B = c.B,
                   .C = c.C,
                   .O = c.O,
                   .x_size = c.x,
                   .y_size = {},
                   .kernel = c.kernel,
                   .stride = c.stride,
                   .padding = c.padding};
  for (std::size_t a = 0; a < 3; ++a)
    g.y_size[a] = (c.x[a] + 2 * c.padding[a] - c.kernel[a]) / c.stride[a] + 1;
  return g;
}

/// Largest |a - b| over the largest |b|.
template <class T>
double difference(const BasicTensor<T>& a, const Doubles& b) {
  double worst = 0, scale = 0;
  for (Index i = 0; i < b.count(); ++i) {
    if (!std::isfinite(a[i])) return INFINITY;
    worst = std::max(worst, std::abs(static_cast<double>(a[i]) - b[i]));
    scale = std::max(scale, std::abs(b[i]));
  }
  return worst / scale;
}

/// The same of moments and the channels they are of.
template <class T>
double difference(const ChannelMoments& moments, const BasicTensor<T>& t, Index channels) {
  const Index n = t.count() / channels;
  Doubles got({3 * channels}), want({3 * channels});
  for (Index c = 0; c < channels; ++c) {
    const Moments& m = moments.at(static_cast<std::size_t>(c));
    double mean = 0, m2 = 0;
    for (Index i = 0; i < n; ++i)
      mean += static_cast<double>(t[c * n + i]) / static_cast<double>(n);
    for (Index i = 0; i < n; ++i) m2 += std::pow(static_cast<double>(t[c * n + i]) - mean, 2);
    got[3 * c] = m.count / static_cast<double>(n);
    got[3 * c + 1] = m.mean;
    got[3 * c + 2] = m.m2 / static_cast<double>(n);
    want[3 * c] = 1;
    want[3 * c + 1] = mean;
    want[3 * c + 2] = m2 / static_cast<double>(n);
  }
  return difference(got, want);
}

/// act(scale (x - centre) + shift) with an affine [3 channels].
Doubles normalised_ref(const Doubles& x, const Doubles& affine, Activation activation) {
  const Index channels = affine.count() / 3, n = x.count() / channels;
  auto out = x.clone();
  for (Index i = 0; i < x.count(); ++i) {
    const double z =
        affine[channels + i / n] * (x[i] - affine[i / n]) + affine[2 * channels + i / n];
    out[i] = activation == Activation::relu   ? std::max(z, 0.0)
             : activation == Activation::gelu ? z * 0.5 * std::erfc(-z / std::sqrt(2.0))
                                              : z;
  }
  return out;
}

/// An affine [3 channels] that leaves most values above 0.
Doubles affine(Index channels, std::uint64_t seed) {
  auto t = normal({3 * channels}, seed);
  for (Index i = 0; i < t.count(); ++i) t[i] = 0.2 * t[i] + (i < channels ? 0 : 1);
  return t;
}

Doubles sum(const Doubles& a, const Doubles& b) {
  auto out = a.clone();
  for (Index i = 0; i < out.count(); ++i) out[i] += b[i];
  return out;
}

/// What a case is computed from and what comes out, the same for all types and instruction sets:
/// the loops take longer than all that they check.
struct Expected {
  conv::Geometry g;
  Doubles x, y, w;
  Doubles correlation, adjoint, weight_gradient;
};

Expected expected(const Case& c) {
  const conv::Geometry g = geometry(c);
  const auto x = normal({g.B * g.C * g.x_count()}, 1), y = normal({g.B * g.O * g.y_count()}, 2),
             w = normal({g.O * g.C * g.taps()}, 3);
  return {g,
          x,
          y,
          w,
          correlate_ref(g, x, w),
          correlate_adjoint_ref(g, y, w),
          weight_gradient_ref(g, x, y)};
}

/// The same of x and y that are normalised while they are read.
struct ExpectedNormalised : Expected {
  Doubles by_x, by_y;
  Activation activation;
};

ExpectedNormalised expected(const Case& c, Activation activation) {
  const conv::Geometry g = geometry(c);
  const auto x = normal({g.B * g.C * g.x_count()}, 1), y = normal({g.B * g.O * g.y_count()}, 2),
             w = normal({g.O * g.C * g.taps()}, 3), by_x = affine(g.B * g.C, 4),
             by_y = affine(g.B * g.O, 5);
  const auto nx = normalised_ref(x, by_x, activation), ny = normalised_ref(y, by_y, activation);
  return {{g, x, y, w, correlate_ref(g, nx, w), correlate_adjoint_ref(g, ny, w),
           weight_gradient_ref(g, nx, ny)},
          by_x,
          by_y,
          activation};
}

/// Inputs that are normalised while they are read, in every role.
template <class T>
void check_normalised_case(const ExpectedNormalised& e, Isa isa) {
  const auto kernels = kernels_for<ConvKernels<T>>(isa);
  const double tolerance = sizeof(T) == 4 ? 3e-6 : 1e-14;
  const auto xt = e.x.cast<T>(), yt = e.y.cast<T>(), wt = e.w.cast<T>(), by_xt = e.by_x.cast<T>(),
             by_yt = e.by_y.cast<T>();
  const conv::Input<T> in_x{xt.data(), by_xt.data(), e.activation},
      in_y{yt.data(), by_yt.data(), e.activation};

  auto out = BasicTensor<T>(e.y.shape(), static_cast<T>(NAN));
  conv::correlate<T>(kernels, e.g, in_x, wt.data(), nullptr, out.data(), false);
  CHECK(difference(out, e.correlation) < tolerance);
  out = BasicTensor<T>(e.x.shape(), static_cast<T>(NAN));
  conv::correlate_adjoint<T>(kernels, e.g, in_y, wt.data(), nullptr, out.data(), false);
  CHECK(difference(out, e.adjoint) < tolerance);
  out = BasicTensor<T>(e.w.shape());
  conv::correlate_weight_gradient<T>(kernels, e.g, in_x, in_y, out.data());
  CHECK(difference(out, e.weight_gradient) < tolerance);
}

template <class T>
void check_case(const Expected& e, Isa isa) {
  const auto kernels = kernels_for<ConvKernels<T>>(isa);
  const conv::Geometry& g = e.g;
  const double tolerance = sizeof(T) == 4 ? 3e-6 : 1e-14;
  const auto bias_y = normal({g.O}, 4), bias_x = normal({g.C}, 5), first_w = normal(e.w.shape(), 6);
  const auto xt = e.x.cast<T>(), yt = e.y.cast<T>(), wt = e.w.cast<T>(), bias_yt = bias_y.cast<T>(),
             bias_xt = bias_x.cast<T>();
  const auto plus_bias = [](const Doubles& t, const Doubles& bias, Index n) {
    auto out = t.clone();
    for (Index i = 0; i < t.count(); ++i) out[i] += bias[i / n % bias.count()];
    return out;
  };

  // Overwriting starts from NaN, so that an element which nobody writes shows.
  auto out = BasicTensor<T>(e.y.shape(), static_cast<T>(NAN));
  ChannelMoments moments;
  conv::correlate<T>(kernels, g, {xt.data()}, wt.data(), bias_yt.data(), out.data(), false,
                     &moments);
  CHECK(difference(out, plus_bias(e.correlation, bias_y, g.y_count())) < tolerance);
  CHECK(difference(moments, out, g.B * g.O) < 10 * tolerance);
  out = yt.clone();
  conv::correlate<T>(kernels, g, {xt.data()}, wt.data(), nullptr, out.data(), true);
  CHECK(difference(out, sum(e.correlation, e.y)) < tolerance);

  out = BasicTensor<T>(e.x.shape(), static_cast<T>(NAN));
  conv::correlate_adjoint<T>(kernels, g, {yt.data()}, wt.data(), bias_xt.data(), out.data(), false,
                             &moments);
  CHECK(difference(out, plus_bias(e.adjoint, bias_x, g.x_count())) < tolerance);
  CHECK(difference(moments, out, g.B * g.C) < 10 * tolerance);
  out = xt.clone();
  conv::correlate_adjoint<T>(kernels, g, {yt.data()}, wt.data(), nullptr, out.data(), true);
  CHECK(difference(out, sum(e.adjoint, e.x)) < tolerance);

  out = first_w.cast<T>();
  conv::correlate_weight_gradient<T>(kernels, g, {xt.data()}, {yt.data()}, out.data());
  CHECK(difference(out, sum(e.weight_gradient, first_w)) < tolerance);

  out = bias_yt.clone();
  conv::bias_gradient(kernels, g.B, g.O, g.y_count(), yt.data(), out.data());
  auto bias = bias_y.clone();
  for (Index i = 0; i < e.y.count(); ++i) bias[i / g.y_count() % g.O] += e.y[i];
  CHECK(difference(out, bias) < tolerance);
}

/// Everything one op computes, forward and backward, at a given number of threads.
std::vector<float> results(const Case& c, int threads) {
  set_threads(threads);
  const Var x(normal({c.B, c.C, c.x[0], c.x[1], c.x[2]}, 1).cast<float>(), true);
  const Var w(normal({c.O, c.C, c.kernel[0], c.kernel[1], c.kernel[2]}, 2).cast<float>(), true);
  const Var b(normal({c.O}, 3).cast<float>(), true);
  const Var y = conv3d(x, w, b, {.stride = c.stride, .padding = c.padding});
  y.backward(normal(y.shape(), 4).cast<float>());
  set_threads(0);
  std::vector<float> all;
  for (const Tensor& t : {y.value(), x.grad(), w.grad(), b.grad()})
    all.insert(all.end(), t.values().begin(), t.values().end());
  return all;
}

BasicVar<double> var(const Shape& shape) { return BasicVar<double>(BasicTensor<double>(shape)); }

}  // namespace

TEST_CASE("convolution kernels agree with nested loops on every instruction set") {
  for (const Case& c : kCases) {
    const Expected e = expected(c);
    for (const Isa isa : test::tested_isas()) {
      CAPTURE(std::string(isa_name(isa)));
      CAPTURE(std::string(c.name));
      check_case<float>(e, isa);
      check_case<double>(e, isa);
    }
  }
}

TEST_CASE("convolutions normalise their inputs while they read them") {
  Index next = 0;  // the activations in turn, so that each meets every kind of layout
  for (const Case& c : kCases) {
    constexpr Activation kAll[] = {Activation::relu, Activation::gelu, Activation::none};
    const ExpectedNormalised first = expected(c, kAll[next++ % 3]),
                             second = expected(c, kAll[next % 3]);
    for (const Isa isa : test::tested_isas()) {
      CAPTURE(std::string(isa_name(isa)));
      CAPTURE(std::string(c.name));
      check_normalised_case<float>(first, isa);
      check_normalised_case<double>(second, isa);
    }
  }
}

TEST_CASE("gradients of convolutions of normalised values") {
  for (const Activation activation : {Activation::none, Activation::relu, Activation::gelu}) {
    const auto of = [activation](const DoubleVars& v) {
      return Normalised<double>(v[0], v[1], activation);
    };
    CHECK(gradcheck(
        [of](const DoubleVars& v) {
          return conv2d(of(v), v[2], v[3], {.padding = {1, 1}});
        },
        {normal({2, 3, 5, 7}, 1), normal({3, 2, 3}, 2), normal({4, 3, 3, 3}, 3), normal({4}, 4)}));
    CHECK(gradcheck(
        [of](const DoubleVars& v) {
          return conv3d(of(v), v[2], {}, {.stride = {2, 2, 2}, .padding = {1, 1, 1}});
        },
        {normal({2, 2, 4, 3, 6}, 5), normal({3, 2, 2}, 6), normal({3, 2, 3, 3, 3}, 7)}));
    CHECK(gradcheck(
        [of](const DoubleVars& v) {
          return conv_transpose3d(of(v), v[2], {}, {{2, 2, 2}, {1, 1, 1}, {1, 1, 1}});
        },
        {normal({2, 2, 2, 3, 3}, 8), normal({3, 2, 2}, 9), normal({2, 3, 3, 3, 3}, 10)}));
  }
}

TEST_CASE("conv2d gradients") {
  const auto f = [](const Conv2dOptions& o) {
    return [o](const DoubleVars& v) { return conv2d(v[0], v[1], v[2], o); };
  };
  CHECK(gradcheck(f({.stride = {1, 1}, .padding = {1, 1}}),
                  {normal({2, 3, 5, 7}, 1), normal({4, 3, 3, 3}, 2), normal({4}, 3)}));
  CHECK(gradcheck(f({.stride = {1, 1}, .padding = {1, 1}}),  // with mixed rows
                  {normal({1, 2, 30, 35}, 1), normal({3, 2, 3, 3}, 2), normal({3}, 3)}));
  CHECK(gradcheck(f({.stride = {2, 2}, .padding = {1, 1}}),
                  {normal({2, 2, 6, 9}, 4), normal({3, 2, 4, 4}, 5), normal({3}, 6)}));
  CHECK(gradcheck(f({.stride = {2, 1}, .padding = {0, 2}}),
                  {normal({2, 3, 4, 6}, 7), normal({2, 3, 1, 2}, 8), normal({2}, 9)}));
}

TEST_CASE("conv3d gradients") {
  const auto f = [](const Conv3dOptions& o) {
    return [o](const DoubleVars& v) { return conv3d(v[0], v[1], v[2], o); };
  };
  CHECK(gradcheck(f({.stride = {1, 1, 1}, .padding = {1, 1, 1}}),
                  {normal({2, 3, 2, 4, 5}, 1), normal({4, 3, 3, 3, 3}, 2), normal({4}, 3)}));
  CHECK(gradcheck(f({.stride = {2, 2, 2}, .padding = {1, 1, 1}}),
                  {normal({2, 2, 4, 5, 7}, 4), normal({3, 2, 3, 3, 3}, 5), normal({3}, 6)}));
  CHECK(gradcheck(f({.stride = {1, 2, 3}, .padding = {1, 0, 2}}),
                  {normal({2, 2, 3, 4, 5}, 7), normal({3, 2, 1, 2, 3}, 8), normal({3}, 9)}));
}

TEST_CASE("conv_transpose3d gradients") {
  const auto f = [](const ConvTranspose3dOptions& o) {
    return [o](const DoubleVars& v) { return conv_transpose3d(v[0], v[1], v[2], o); };
  };
  CHECK(gradcheck(f({.stride = {2, 2, 2}, .padding = {1, 1, 1}, .output_padding = {1, 1, 1}}),
                  {normal({2, 3, 2, 3, 4}, 1), normal({3, 2, 3, 3, 3}, 2), normal({2}, 3)}));
  CHECK(gradcheck(f({.stride = {1, 2, 3}, .padding = {0, 1, 1}, .output_padding = {0, 0, 2}}),
                  {normal({2, 2, 3, 4, 3}, 4), normal({2, 3, 2, 3, 4}, 5), normal({3}, 6)}));
}

TEST_CASE("convolutions without a bias") {
  CHECK(gradcheck([](const DoubleVars& v) { return conv2d(v[0], v[1], BasicVar<double>()); },
                  {normal({2, 3, 4, 5}, 1), normal({2, 3, 3, 2}, 2)}));
  CHECK(gradcheck(
      [](const DoubleVars& v) { return conv_transpose3d(v[0], v[1], BasicVar<double>()); },
      {normal({2, 3, 2, 3, 4}, 1), normal({3, 2, 1, 3, 2}, 2)}));
}

TEST_CASE("conv3d of a known sequence") {
  const BasicVar<double> x(BasicTensor<double>::from({1, 1, 1, 1, 4}, {1, 2, 3, 4}));
  const BasicVar<double> w(BasicTensor<double>::from({1, 1, 1, 1, 3}, {10, 100, 1000}));
  const BasicVar<double> b(BasicTensor<double>::from({1}, {0.5}));
  const auto y = conv3d(x, w, b, {.stride = {1, 1, 1}, .padding = {0, 0, 1}});
  CHECK(y.shape() == Shape{1, 1, 1, 1, 4});
  CHECK(std::vector<double>(y.value().values().begin(), y.value().values().end()) ==
        std::vector<double>{2100.5, 3210.5, 4320.5, 430.5});
  const auto t = conv_transpose3d(x, w, b, {.stride = {1, 1, 2}, .output_padding = {0, 0, 1}});
  CHECK(t.shape() == Shape{1, 1, 1, 1, 10});
  CHECK(std::vector<double>(t.value().values().begin(), t.value().values().end()) ==
        std::vector<double>{10.5, 100.5, 1020.5, 200.5, 2030.5, 300.5, 3040.5, 400.5, 4000.5, 0.5});
}

TEST_CASE("conv_transpose3d is the adjoint of conv3d") {
  const auto x = normal({2, 3, 4, 6, 8}, 1), w = normal({5, 3, 3, 3, 3}, 2);
  const auto y = conv3d(BasicVar<double>(x), BasicVar<double>(w), BasicVar<double>(),
                        {.stride = {2, 2, 2}, .padding = {1, 1, 1}});
  const auto g = normal(y.shape(), 3);
  const auto back =
      conv_transpose3d(BasicVar<double>(g), BasicVar<double>(w), BasicVar<double>(),
                       {.stride = {2, 2, 2}, .padding = {1, 1, 1}, .output_padding = {1, 1, 1}});
  REQUIRE(back.shape() == x.shape());
  double left = 0, right = 0;
  for (Index i = 0; i < y.count(); ++i) left += y.value()[i] * g[i];
  for (Index i = 0; i < x.count(); ++i) right += x[i] * back.value()[i];
  CHECK(left == doctest::Approx(right).epsilon(1e-12));
}

TEST_CASE("convolutions give the same bits on one and on two threads") {
  for (const Case& c : kCases) {
    CAPTURE(std::string(c.name));
    CHECK(results(c, 1) == results(c, 2));
  }
}

TEST_CASE("conv3d_rows writes the rows of conv3d into a larger tensor and nothing else") {
  struct RowsCase {
    Index C, O;
    std::array<Index, 3> x, kernel, padding;
  };
  // mixed rows, too few outputs for that, and one tap, whose planes are joined otherwise
  for (const RowsCase& c : {RowsCase{5, 9, {3, 7, 37}, {3, 3, 3}, {1, 0, 1}},
                            RowsCase{3, 1, {3, 6, 18}, {3, 3, 3}, {1, 0, 1}},
                            RowsCase{4, 8, {2, 4, 32}, {1, 1, 1}, {0, 0, 0}}}) {
    CAPTURE(c.O);
    const auto x = normal({1, c.C, c.x[0], c.x[1], c.x[2]}, 1);
    const BasicVar<double> w(normal({c.O, c.C, c.kernel[0], c.kernel[1], c.kernel[2]}, 2));
    const Normalised<double> in{BasicVar<double>(x), BasicVar<double>(normal({3, 1, c.C}, 3)),
                                Activation::relu};
    ChannelMoments moments, of_rows;
    const auto whole = conv3d(in, w, {}, {.padding = c.padding}, &moments).value();
    constexpr Index kFirst = 2, kBehind = 3;
    const Index D = whole.dim(2), H = whole.dim(3), W = whole.dim(4), R = kFirst + H + kBehind;
    BasicTensor<double> out({1, c.O, D, R, W}, -7.0);
    conv3d_rows(in, w, c.padding, out, kFirst, &of_rows);
    bool equal = true, kept = true;
    for (Index plane = 0; plane < c.O * D; ++plane)
      for (Index y = 0; y < R; ++y)
        for (Index k = 0; k < W; ++k) {
          const double v = out[(plane * R + y) * W + k];
          if (y < kFirst || y >= kFirst + H)
            kept = kept && v == -7;
          else
            equal = equal && std::abs(v - whole[(plane * H + y - kFirst) * W + k]) < 1e-12;
        }
    CHECK(equal);
    CHECK(kept);
    REQUIRE(of_rows.size() == moments.size());
    for (std::size_t o = 0; o < moments.size(); ++o) {
      CHECK(of_rows[o].count == moments[o].count);
      CHECK(of_rows[o].mean == doctest::Approx(moments[o].mean));
      CHECK(of_rows[o].m2 == doctest::Approx(moments[o].m2));
    }
  }
}

TEST_CASE("convolutions of no image") {
  const BasicVar<double> x(BasicTensor<double>({0, 2, 5, 7}), true),
      w(normal({3, 2, 3, 3}, 1), true);
  const auto y = conv2d(x, w, BasicVar<double>(), {.stride = {2, 2}, .padding = {1, 1}});
  CHECK(y.shape() == Shape{0, 3, 3, 4});
  y.backward(BasicTensor<double>(y.shape()));
  CHECK(std::all_of(w.grad().values().begin(), w.grad().values().end(),
                    [](double v) { return v == 0.0; }));
}

TEST_CASE("convolutions refuse what does not fit") {
  const auto none = BasicVar<double>();
  CHECK_THROWS_WITH_AS(conv2d(var({2, 3, 5, 7}), var({4, 2, 3, 3}), none),
                       "conv2d: weight has shape [4,2,3,3], expected [O C KH KW] with C=3 from x",
                       ShapeError);
  CHECK_THROWS_WITH_AS(conv2d(var({2, 3, 5, 7}), var({4, 3, 3, 3}), var({5})),
                       "conv2d: bias has shape [5], expected [O] with O=4 from weight", ShapeError);
  CHECK_THROWS_WITH_AS(conv2d(var({2, 3, 5}), var({4, 3, 3, 3}), none),
                       "conv2d: x has shape [2,3,5], expected [B C H W]", ShapeError);
  CHECK_THROWS_WITH_AS(conv2d(var({1, 1, 5, 7}), var({1, 1, 3, 3}), none, {.stride = {1, 0}}),
                       "conv2d: stride [1,0], expected 1 or more", ShapeError);
  CHECK_THROWS_WITH_AS(conv2d(var({1, 1, 5, 7}), var({1, 1, 3, 3}), none, {.padding = {-1, 0}}),
                       "conv2d: padding [-1,0], expected 0 or more", ShapeError);
  CHECK_THROWS_WITH_AS(conv2d(var({1, 1, 5, 7}), var({1, 1, 3, 0}), none),
                       "conv2d: weight has shape [1,1,3,0], expected no extent of 0", ShapeError);
  CHECK_THROWS_WITH_AS(
      conv3d(var({1, 1, 2, 5, 7}), var({1, 1, 3, 3, 3}), none),
      "conv3d: x has shape [1,1,2,5,7] and weight [1,1,3,3,3], expected a kernel no "
      "larger than the padded x",
      ShapeError);
  CHECK_THROWS_WITH_AS(
      conv3d(var({2, 3, 2, 5, 7}), var({4, 2, 1, 3, 3}), none),
      "conv3d: weight has shape [4,2,1,3,3], expected [O C KD KH KW] with C=3 from x", ShapeError);
  auto rows = BasicTensor<double>({1, 4, 2, 6, 7});
  CHECK_THROWS_WITH_AS(conv3d_rows<double>(var({1, 2, 2, 5, 7}), var({4, 2, 1, 1, 1}), {}, rows, 2),
                       "conv3d_rows: rows from 2 on in out of shape [1,4,2,6,7], expected room for "
                       "[1,4,2,5,7]",
                       ShapeError);
  CHECK_THROWS_AS(conv3d_rows<double>(var({1, 2, 2, 5, 6}), var({4, 2, 1, 1, 1}), {}, rows, 0),
                  ShapeError);
  CHECK_THROWS_AS(conv3d_rows<double>(var({2, 2, 2, 5, 7}), var({4, 2, 1, 1, 1}), {}, rows, 0),
                  ShapeError);
  CHECK_THROWS_WITH_AS(
      conv_transpose3d(var({2, 3, 2, 5, 7}), var({4, 2, 1, 3, 3}), none),
      "conv_transpose3d: weight has shape [4,2,1,3,3], expected [C O KD KH KW] with "
      "C=3 from x",
      ShapeError);
  CHECK_THROWS_WITH_AS(
      conv_transpose3d(var({1, 1, 2, 2, 2}), var({1, 1, 3, 3, 3}), none,
                       {.stride = {2, 2, 2}, .padding = {1, 1, 1}, .output_padding = {2, 1, 1}}),
      "conv_transpose3d: output_padding [2,1,1], expected 0 or more and less than stride [2,2,2]",
      ShapeError);
  CHECK_THROWS_WITH_AS(
      conv_transpose3d(var({1, 1, 1, 2, 2}), var({1, 1, 1, 3, 3}), none, {.padding = {1, 0, 0}}),
      "conv_transpose3d: padding [1,0,0] leaves no output of x [1,1,1,2,2] and "
      "weight [1,1,1,3,3], expected at least one",
      ShapeError);
}

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/cost_volume.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <string>

namespace satsurf {
namespace {

/// One view at one sample: the four neighbours and their weights; all weights 0 where it does not
/// count.
template <class T>
struct Tap {
  bool counts = false;
  std::array<Index, 4> at{};
  std::array<T, 4> weight{};
};

/// A map restricted to one reference pixel: out = c0 + t (c1 + t c2), t = normalised height.
struct PixelLine {
  std::array<double, 3> u{}, v{};

  PixelLine(const Quadratic& q, double x, double y) {
    const double a = (x - q.offset[0]) / q.scale[0], b = (y - q.offset[1]) / q.scale[1];
    for (std::size_t k = 0; k < 2; ++k) {
      const auto& c = q.coeff[k];
      (k == 0 ? u : v) = {c[0] + a * (c[1] + c[4] * a + c[5] * b) + b * (c[2] + c[7] * b),
                          c[3] + c[6] * a + c[8] * b, c[9]};
    }
  }
};

template <class T>
Tap<T> tap_at(double u, double v, Index H, Index W, const T* valid) {
  Tap<T> t;
  if (!(u >= 0 && u <= static_cast<double>(W - 1) && v >= 0 && v <= static_cast<double>(H - 1)))
    return t;
  if (valid != nullptr &&
      valid[static_cast<Index>(v + 0.5) * W + static_cast<Index>(u + 0.5)] == T(0))
    return t;
  const Index x0 = std::min(static_cast<Index>(u), std::max<Index>(0, W - 2));
  const Index y0 = std::min(static_cast<Index>(v), std::max<Index>(0, H - 2));
  const Index x1 = std::min(x0 + 1, W - 1), y1 = std::min(y0 + 1, H - 1);
  const T fx = static_cast<T>(u - static_cast<double>(x0));
  const T fy = static_cast<T>(v - static_cast<double>(y0));
  t.counts = true;
  t.at = {y0 * W + x0, y0 * W + x1, y1 * W + x0, y1 * W + x1};
  t.weight = {(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy};
  return t;
}

}  // namespace

template <class T>
BasicVar<T> plane_sweep_variance(const BasicVar<T>& features, Index reference,
                                 const std::vector<Quadratic>& maps, const BasicTensor<T>& heights,
                                 const BasicTensor<T>& valid, bool include_reference) {
  Dims dim("plane_sweep_variance");
  dim.match("features", features, "N C H W").match("heights", heights, "D H W");
  if (!valid.empty()) dim.match("valid", valid, "N H W");
  const Index N = dim["N"], C = dim["C"], D = dim["D"], H = dim["H"], W = dim["W"], P = H * W;
  if (reference < 0 || reference >= N)
    throw ShapeError("plane_sweep_variance: reference is " + std::to_string(reference) +
                     ", expected one of " + std::to_string(N) + " views");
  if (static_cast<Index>(maps.size()) != N)
    throw ShapeError("plane_sweep_variance: " + std::to_string(maps.size()) +
                     " maps, expected one for each of " + std::to_string(N) + " views");

  // body(d, pixel, taps, n): every sample of reference row y.
  const auto each_sample = [=](Index y, const auto& body) {
    std::vector<Tap<T>> taps(static_cast<std::size_t>(N));
    for (Index x = 0; x < W; ++x)
      for (Index d = 0; d < D; ++d) {
        const Index pixel = y * W + x;
        const double z = static_cast<double>(heights[d * P + pixel]);
        Index count = include_reference ? 1 : 0;
        for (Index j = 0; j < N; ++j) {
          Tap<T>& t = taps[static_cast<std::size_t>(j)];
          if (j == reference) {
            t = {include_reference, {pixel, pixel, pixel, pixel}, {1, 0, 0, 0}};
            continue;
          }
          const Quadratic& q = maps[static_cast<std::size_t>(j)];
          const PixelLine line(q, static_cast<double>(x), static_cast<double>(y));
          const double s = (z - q.offset[2]) / q.scale[2];
          t = tap_at(line.u[0] + s * (line.u[1] + s * line.u[2]),
                     line.v[0] + s * (line.v[1] + s * line.v[2]), H, W,
                     valid.empty() ? nullptr : valid.data() + j * P);
          count += t.counts ? 1 : 0;
        }
        body(d, pixel, taps, count);
      }
  };
  const auto sample = [=](const T* map, const Tap<T>& t) {
    T f = 0;
    for (std::size_t k = 0; k < 4; ++k) f += t.weight[k] * map[t.at[k]];
    return f;
  };

  BasicTensor<T> out({C, D, H, W});
  for_each_index(H, [&](Index y) {
    const T* f = features.value().data();
    each_sample(y, [&](Index d, Index pixel, const std::vector<Tap<T>>& taps, Index count) {
      if (count < 2) return;
      const T share = T(1) / static_cast<T>(count);
      for (Index c = 0; c < C; ++c) {
        T first = 0, second = 0;
        for (Index j = 0; j < N; ++j) {
          const Tap<T>& t = taps[static_cast<std::size_t>(j)];
          if (!t.counts) continue;
          const T e = sample(f + (j * C + c) * P, t);
          first += e;
          second += e * e;
        }
        out[(c * D + d) * P + pixel] = second * share - first * share * (first * share);
      }
    });
  });

  return BasicVar<T>::record("plane_sweep_variance", out, {features}, [=](Node<T>& n) {
    T* df = n.grad_in(0);
    if (df == nullptr) return;
    const T *f = n.in(0), *g = n.grad.data();
    for_each_index(C, [&](Index c) {  // a channel's gradient is written by its own piece alone
      for (Index y = 0; y < H; ++y)
        each_sample(y, [&](Index d, Index pixel, const std::vector<Tap<T>>& taps, Index count) {
          if (count < 2) return;
          T mean = 0;
          for (Index j = 0; j < N; ++j)
            if (const Tap<T>& t = taps[static_cast<std::size_t>(j)]; t.counts)
              mean += sample(f + (j * C + c) * P, t);
          mean /= static_cast<T>(count);
          const T scale = 2 * g[(c * D + d) * P + pixel] / static_cast<T>(count);
          for (Index j = 0; j < N; ++j) {
            const Tap<T>& t = taps[static_cast<std::size_t>(j)];
            if (!t.counts) continue;
            const T e = scale * (sample(f + (j * C + c) * P, t) - mean);
            for (std::size_t k = 0; k < 4; ++k) df[(j * C + c) * P + t.at[k]] += t.weight[k] * e;
          }
        });
    });
  });
}

template BasicVar<float> plane_sweep_variance(const BasicVar<float>&, Index,
                                              const std::vector<Quadratic>&,
                                              const BasicTensor<float>&, const BasicTensor<float>&,
                                              bool);
template BasicVar<double> plane_sweep_variance(const BasicVar<double>&, Index,
                                               const std::vector<Quadratic>&,
                                               const BasicTensor<double>&,
                                               const BasicTensor<double>&, bool);

}  // namespace satsurf

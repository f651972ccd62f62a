// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/input.h"

#include "satsurf/core/parallel.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

namespace satsurf::nn {

namespace {

/// What takes an image to zero mean and a deviation of almost 1.
struct Levels {
  double mean, factor;
};

struct Sums {
  double values = 0, squares = 0, count = 0;
  Sums& operator+=(const Sums& more) {
    values += more.values, squares += more.squares, count += more.count;
    return *this;
  }
};

Levels levels_of(const PosedImage& v) {
  const Index P = v.valid.count();
  const auto [sum, squares, count] =
      ordered_reduce(P, 1 << 14, Sums(), [&](Index begin, Index end) {
        Sums part;
        for (Index i = begin; i < end; ++i)
          if (v.valid[i] > 0)
            for (Index c = 0; c < 3; ++c) {
              const double x = static_cast<double>(v.rgb[c * P + i]);
              part += {x, x * x, 1};
            }
        return part;
      });
  const double mean = count > 0 ? sum / count : 0;
  const double variance = count > 0 ? std::max(squares / count - mean * mean, 0.0) : 0;
  constexpr double kFlat = 1e-3;
  return {mean, 1 / (std::sqrt(variance) + kFlat)};
}

}  // namespace

double standardised_black(const PosedImage& v) {
  const Levels levels = levels_of(v);
  return -levels.mean * levels.factor;
}

template <class T>
BasicTensor<T> standardised(const PosedImage& v) {
  const Index H = v.rgb.dim(1), W = v.rgb.dim(2), P = H * W;
  const Levels levels = levels_of(v);
  auto out = BasicTensor<T>::uninitialised({1, 3, H, W});
  for_each_index(3 * H, [&](Index row) {
    for (Index i = row * W; i < (row + 1) * W; ++i)
      out[i] = v.valid[i % P] > 0
                   ? static_cast<T>((static_cast<double>(v.rgb[i]) - levels.mean) * levels.factor)
                   : T(0);
  });
  return out;
}

template <class T>
BasicTensor<T> locally_normalised(const PosedImage& v) {
  constexpr Index kReach = 7;
  constexpr double kFlat = 0.01;  // a few grey levels: noise is no texture
  constexpr double kMost = 4;
  const Index H = v.rgb.dim(1), W = v.rgb.dim(2), P = H * W;
  // Sums of brightness, its square and the count over a row's part of each window.
  BasicTensor<double> sums({3, H, W});
  const auto brightness = [&](Index i) {
    return (static_cast<double>(v.rgb[i]) + static_cast<double>(v.rgb[P + i]) +
            static_cast<double>(v.rgb[2 * P + i])) /
           3;
  };
  for_each_index(H, [&](Index y) {
    double now[3]{};
    const auto move = [&](Index x, double sign) {
      if (x < 0 || x >= W || v.valid[y * W + x] <= 0) return;
      const double b = brightness(y * W + x);
      now[0] += sign * b;
      now[1] += sign * b * b;
      now[2] += sign;
    };
    for (Index x = 0; x < kReach; ++x) move(x, 1);
    for (Index x = 0; x < W; ++x) {
      move(x + kReach, 1);
      move(x - kReach - 1, -1);
      for (Index k = 0; k < 3; ++k) sums[k * P + y * W + x] = now[k];
    }
  });
  auto out = BasicTensor<T>::uninitialised({1, 1, H, W});
  constexpr Index kRows = 64;  // whose windows' sums go on from row to row
  for_range(H, kRows, [&](Index begin, Index end) {
    std::vector<double> windows(static_cast<std::size_t>(3 * W));  // sums
    const auto move = [&](Index row, double sign) {
      if (row < 0 || row >= H) return;
      for (Index k = 0; k < 3; ++k)
        for (Index x = 0; x < W; ++x) windows[k * W + x] += sign * sums[k * P + row * W + x];
    };
    for (Index row = begin - kReach; row < begin + kReach; ++row) move(row, 1);
    for (Index y = begin; y < end; ++y) {
      move(y + kReach, 1);
      if (y > begin) move(y - kReach - 1, -1);
      for (Index x = 0; x < W; ++x) {
        const Index i = y * W + x;
        const double count = windows[2 * W + x], mean = windows[x] / count,
                     variance = std::max(windows[W + x] / count - mean * mean, 0.0);
        out[i] = v.valid[i] > 0
                     ? static_cast<T>(std::clamp(
                           (brightness(i) - mean) / (std::sqrt(variance) + kFlat), -kMost, kMost))
                     : T(0);
      }
    }
  });
  return out;
}

template BasicTensor<float> locally_normalised(const PosedImage&);
template BasicTensor<double> locally_normalised(const PosedImage&);
template BasicTensor<float> standardised(const PosedImage&);
template BasicTensor<double> standardised(const PosedImage&);

}  // namespace satsurf::nn

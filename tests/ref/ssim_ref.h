// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/tensor.h"

#include <cmath>

/// Structural similarity straight from its definition: one pixel at a time, a whole 2D window each,
/// moments about the window's own means.
namespace satsurf::test {

struct SsimRef {
  bool whole_windows;  ///< only pixels whose window lies inside; else zeros beyond the borders
  double covariance;   ///< factor of variances and covariance
};
inline constexpr SsimRef kSkimageRef{true, 121.0 / 120.0}, kConvRef{false, 1.0};

/// Sum over the pixels that count of one channel, and their number.
struct SsimRefSum {
  double sum = 0, pixels = 0;
};
inline SsimRefSum ssim_ref(const double* x, const double* y, const double* mask, Index H, Index W,
                           const SsimRef& how) {
  double all = 0;
  for (Index a = -5; a <= 5; ++a)
    for (Index b = -5; b <= 5; ++b) all += std::exp(-static_cast<double>(a * a + b * b) / 4.5);
  SsimRefSum out;
  for (Index i = 0; i < H; ++i)
    for (Index j = 0; j < W; ++j) {
      if (mask != nullptr && mask[i * W + j] == 0) continue;
      if (how.whole_windows && (i < 5 || j < 5 || i + 5 >= H || j + 5 >= W)) continue;
      const auto expected = [&](const auto& f) {
        double sum = 0;
        for (Index a = -5; a <= 5; ++a)
          for (Index b = -5; b <= 5; ++b) {
            const Index r = i + a, c = j + b, at = r * W + c;
            const bool seen =
                r >= 0 && c >= 0 && r < H && c < W && (mask == nullptr || mask[at] != 0);
            sum += std::exp(-static_cast<double>(a * a + b * b) / 4.5) / all *
                   f(seen ? x[at] : 0, seen ? y[at] : 0);
          }
        return sum;
      };
      const double mx = expected([](double u, double) { return u; });
      const double my = expected([](double, double v) { return v; });
      const double vx = expected([&](double u, double) { return (u - mx) * (u - mx); });
      const double vy = expected([&](double, double v) { return (v - my) * (v - my); });
      const double c = expected([&](double u, double v) { return (u - mx) * (v - my); });
      const double n = how.covariance;
      out.sum += (2 * mx * my + 1e-4) * (2 * n * c + 9e-4) /
                 ((mx * mx + my * my + 1e-4) * (n * vx + n * vy + 9e-4));
      out.pixels += 1;
    }
  return out;
}

/// Mean over `planes` channels, one mask [H W] for all or nullptr.
inline double ssim_ref(const BasicTensor<double>& x, const BasicTensor<double>& y,
                       const double* mask, Index planes, Index H, Index W, const SsimRef& how) {
  SsimRefSum all;
  for (Index p = 0; p < planes; ++p) {
    const SsimRefSum one = ssim_ref(x.data() + p * H * W, y.data() + p * H * W, mask, H, W, how);
    all.sum += one.sum, all.pixels += one.pixels;
  }
  return all.sum / all.pixels;
}

}  // namespace satsurf::test

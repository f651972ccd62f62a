// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/quadratic.h"
#include "satsurf/core/tensor.h"

#include <algorithm>
#include <cmath>
#include <vector>

namespace satsurf::test {

/// The definition in ops/cost_volume.h, one sample at a time.
inline BasicTensor<double> plane_sweep_variance_ref(
    const BasicTensor<double>& features, Index reference, const std::vector<Quadratic>& maps,
    const BasicTensor<double>& heights, const BasicTensor<double>& valid, bool include_reference) {
  const Index N = features.dim(0), C = features.dim(1), H = features.dim(2), W = features.dim(3);
  const Index D = heights.dim(0);
  BasicTensor<double> out({C, D, H, W});
  const auto pixel = [&](Index j, Index c, double x, double y) {  // clamped to the map
    const Index i = std::clamp<Index>(static_cast<Index>(x), 0, W - 1);
    const Index k = std::clamp<Index>(static_cast<Index>(y), 0, H - 1);
    return features[((j * C + c) * H + k) * W + i];
  };
  for (Index c = 0; c < C; ++c)
    for (Index d = 0; d < D; ++d)
      for (Index y = 0; y < H; ++y)
        for (Index x = 0; x < W; ++x) {
          std::vector<double> f;
          for (Index j = 0; j < N; ++j) {
            if (j == reference) {
              if (include_reference) f.push_back(features[((j * C + c) * H + y) * W + x]);
              continue;
            }
            const auto [u, v] = maps[static_cast<std::size_t>(j)](
                static_cast<double>(x), static_cast<double>(y), heights[(d * H + y) * W + x]);
            if (!(u >= 0 && u <= static_cast<double>(W - 1) && v >= 0 &&
                  v <= static_cast<double>(H - 1)))
              continue;
            const auto near_x = static_cast<Index>(std::floor(u + 0.5));
            const auto near_y = static_cast<Index>(std::floor(v + 0.5));
            if (!valid.empty() && valid[(j * H + near_y) * W + near_x] == 0) continue;
            const double x0 = std::floor(u), y0 = std::floor(v), fx = u - x0, fy = v - y0;
            f.push_back(
                (1 - fy) * ((1 - fx) * pixel(j, c, x0, y0) + fx * pixel(j, c, x0 + 1, y0)) +
                fy * ((1 - fx) * pixel(j, c, x0, y0 + 1) + fx * pixel(j, c, x0 + 1, y0 + 1)));
          }
          if (f.size() < 2) continue;
          double first = 0, second = 0;
          for (const double e : f) {
            first += e / static_cast<double>(f.size());
            second += e * e / static_cast<double>(f.size());
          }
          out[((c * D + d) * H + y) * W + x] = second - first * first;
        }
  return out;
}

}  // namespace satsurf::test

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/box_mean.h"

#include "satsurf/core/parallel.h"

#include <algorithm>
#include <vector>

namespace satsurf::scene {

Tensor box_mean(const Tensor& grid, Index radius) {
  const Index H = grid.dim(0), W = grid.dim(1);
  auto rows = Tensor::uninitialised({H, W}), out = Tensor::uninitialised({H, W});
  for_range(H, 32, [&](Index begin, Index end) {
    for (Index i = begin; i < end; ++i) {
      const float* g = grid.data() + i * W;
      double sum = 0;
      Index count = std::min(radius, W);
      for (Index j = 0; j < count; ++j) sum += static_cast<double>(g[j]);
      for (Index j = 0; j < W; ++j) {
        if (j + radius < W) sum += static_cast<double>(g[j + radius]), ++count;
        if (j > radius) sum -= static_cast<double>(g[j - radius - 1]), --count;
        rows[i * W + j] = static_cast<float>(sum / static_cast<double>(count));
      }
    }
  });
  for_range(W, 128, [&](Index begin, Index end) {
    std::vector<double> sum(static_cast<std::size_t>(end - begin), 0.0);
    Index count = std::min(radius, H);
    const auto add = [&](Index i, double sign) {
      for (Index j = begin; j < end; ++j) {
        sum[static_cast<std::size_t>(j - begin)] += sign * static_cast<double>(rows[i * W + j]);
      }
    };
    for (Index i = 0; i < count; ++i) add(i, 1.0);
    for (Index i = 0; i < H; ++i) {
      if (i + radius < H) add(i + radius, 1.0), ++count;
      if (i > radius) add(i - radius - 1, -1.0), --count;
      for (Index j = begin; j < end; ++j) {
        out[i * W + j] = static_cast<float>(sum[static_cast<std::size_t>(j - begin)] /
                                            static_cast<double>(count));
      }
    }
  });
  return out;
}

}  // namespace satsurf::scene

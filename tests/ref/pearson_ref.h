// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/tensor.h"
#include "satsurf/ops/pearson.h"

#include <cmath>
#include <map>
#include <tuple>
#include <vector>

namespace satsurf::test {

struct PatchPearsonRef {
  BasicTensor<double> local, global, defined;
  std::vector<double> deviation_x;  ///< of each view
};

inline double mean_ref(const BasicTensor<double>& t, const std::vector<Index>& pixels) {
  double sum = 0;
  for (const Index i : pixels) sum += t[i];
  return sum / static_cast<double>(pixels.size());
}

/// mean((a - mean a) (b - mean b))
inline double covariance_ref(const BasicTensor<double>& a, const BasicTensor<double>& b,
                             const std::vector<Index>& pixels) {
  const double ma = mean_ref(a, pixels), mb = mean_ref(b, pixels);
  double sum = 0;
  for (const Index i : pixels) sum += (a[i] - ma) * (b[i] - mb);
  return sum / static_cast<double>(pixels.size());
}

/// The definition in ops/pearson.h: pixels are sorted into patches by their coordinates.
/// deviation_x  S_x of each view, or empty to take it from x
inline PatchPearsonRef patch_pearson_ref(const BasicTensor<double>& x, const BasicTensor<double>& y,
                                         const BasicTensor<double>& valid,
                                         const PatchPearsonOptions& options,
                                         std::vector<double> deviation_x = {}) {
  const Index N = x.dim(0), H = x.dim(1), W = x.dim(2);
  PatchPearsonRef out{BasicTensor<double>(x.shape()),
                      BasicTensor<double>(x.shape()),
                      BasicTensor<double>(x.shape()),
                      {}};
  BasicTensor<double> grids(x.shape());
  const auto cell = [](Index at, Index extent, Index side, Index offset) -> Index {
    if (side >= extent) return 0;
    return static_cast<Index>(
        std::floor(static_cast<double>(at - offset) / static_cast<double>(side)));
  };
  for (Index n = 0; n < N; ++n) {
    std::vector<Index> view;
    for (Index i = n * H * W; i < (n + 1) * H * W; ++i)
      if (valid.empty() || valid[i] != 0) view.push_back(i);
    const double of_x = !deviation_x.empty() ? deviation_x[static_cast<std::size_t>(n)]
                        : view.empty()       ? 0
                                             : std::sqrt(covariance_ref(x, x, view));
    const double of_y = view.empty() ? 0 : std::sqrt(covariance_ref(y, y, view));
    out.deviation_x.push_back(of_x);
    for (const PatchGrid& grid : options.grids) {
      std::map<std::tuple<Index, Index>, std::vector<Index>> patches;
      for (const Index i : view)
        patches[{cell(i / W % H, H, grid.side, grid.top), cell(i % W, W, grid.side, grid.left)}]
            .push_back(i);
      const auto full = static_cast<double>(std::min(grid.side, H) * std::min(grid.side, W));
      for (const auto& [key, pixels] : patches) {
        if (static_cast<double>(pixels.size()) < options.min_valid * full) continue;
        const double mx = mean_ref(x, pixels), my = mean_ref(y, pixels);
        const double sx = std::sqrt(covariance_ref(x, x, pixels));
        const double sy = std::sqrt(covariance_ref(y, y, pixels));
        if (sy <= 1e-12 * of_y || sy < options.flat * of_y) continue;  // rounding is flat, too
        const double rho = covariance_ref(x, y, pixels) / ((sx + options.eps) * sy);
        for (const Index i : pixels) {
          const double apart = (x[i] - mx) / (of_x + options.eps) - (y[i] - my) / of_y;
          out.local[i] += 1 - rho;
          out.global[i] += apart * apart / 2;
          grids[i] += 1;
        }
      }
    }
  }
  for (Index i = 0; i < x.count(); ++i) {
    if (grids[i] == 0) continue;
    out.local[i] /= grids[i];
    out.global[i] /= grids[i];
    out.defined[i] = 1;
  }
  return out;
}

}  // namespace satsurf::test

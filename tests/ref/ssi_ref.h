// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/tensor.h"
#include "satsurf/ops/ssi_loss.h"

#include <cmath>
#include <vector>

namespace satsurf::test {

struct SsiRef {
  double distance = 0, gradient = 0;
  Index maps = 0;
};

/// The definition in ops/ssi_loss.h, map by map.
inline SsiRef ssi_ref(const BasicTensor<double>& x, const BasicTensor<double>& y,
                      const BasicTensor<double>& valid, const SsiLossOptions& options) {
  const Index N = x.dim(0), H = x.dim(1), W = x.dim(2);
  SsiRef out;
  for (Index n = 0; n < N; ++n) {
    const auto at = [&](Index row, Index column) { return (n * H + row) * W + column; };
    const auto counts = [&](Index i) { return valid.empty() || valid[i] != 0; };
    std::vector<Index> pixels;
    for (Index i = n * H * W; i < (n + 1) * H * W; ++i)
      if (counts(i)) pixels.push_back(i);
    const auto mean = [&](const BasicTensor<double>& t) {
      double sum = 0;
      for (const Index i : pixels) sum += t[i] / static_cast<double>(pixels.size());
      return sum;
    };
    const auto deviation = [&](const BasicTensor<double>& t) {
      double sum = 0;
      const double m = mean(t);
      for (const Index i : pixels) sum += std::abs(t[i] - m) / static_cast<double>(pixels.size());
      return sum;
    };
    if (pixels.size() < 2 || deviation(y) <= std::max(options.flat, 1e-9)) continue;  // rounding
    ++out.maps;
    const double mx = mean(x), my = mean(y), sx = deviation(x) + options.eps, sy = deviation(y);
    const auto R = [&](Index i) { return (x[i] - mx) / sx - (y[i] - my) / sy; };
    for (const Index i : pixels)
      out.distance += std::abs(R(i)) / static_cast<double>(pixels.size());
    for (Index k = 0, step = 1; k < options.scales; ++k, step *= 2)
      for (const bool down : {false, true}) {
        double sum = 0, pairs = 0;
        for (Index r = 0; r < H; r += step)
          for (Index c = 0; c < W; c += step) {
            const Index r2 = down ? r + step : r, c2 = down ? c : c + step;
            if (r2 >= H || c2 >= W || !counts(at(r, c)) || !counts(at(r2, c2))) continue;
            sum += std::abs(R(at(r2, c2)) - R(at(r, c)));
            pairs += 1;
          }
        if (pairs > 0) out.gradient += sum / pairs;
      }
  }
  if (out.maps > 0) {
    out.distance /= static_cast<double>(out.maps);
    out.gradient /= static_cast<double>(out.maps);
  }
  return out;
}

}  // namespace satsurf::test

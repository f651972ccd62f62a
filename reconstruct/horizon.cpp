// SPDX-License-Identifier: Apache-2.0
#include "satsurf/reconstruct/horizon.h"

#include "satsurf/core/dims.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <utility>
#include <vector>

namespace satsurf::reconstruct {
namespace {

constexpr float kNothing = -std::numeric_limits<float>::infinity();

/// Linear between two heights; the nearer one where either is none.
float between(float a, float b, float share) {
  if (!std::isfinite(a) || !std::isfinite(b)) return share < 0.5F ? a : b;
  return a + share * (b - a);
}

}  // namespace

Tensor sight_horizon(const Tensor& surface, double step, const std::array<double, 2>& toward) {
  Dims dim("sight_horizon");
  dim.match("surface", surface, "H W");
  const Index H = dim["H"], W = dim["W"];
  Tensor out({H, W}, kNothing);
  // Columns and rows towards the satellite per metre of height. The longer one is walked cell by cell.
  const double u = toward[0] / step, v = -toward[1] / step;
  const bool columns = std::abs(u) >= std::abs(v);
  const double along = columns ? u : v, across = columns ? v : u;
  if (!(std::abs(along) > 1e-9)) return out;
  const auto rise = static_cast<float>(1 / std::abs(along));  // m from cell to cell
  const double shift = across / std::abs(along);              // cells aside, no more than one
  const auto aside = static_cast<Index>(std::floor(shift));
  const auto share = static_cast<float>(shift - std::floor(shift));
  const Index lines = columns ? W : H, cells = columns ? H : W, stride = columns ? W : 1,
              from_line = columns ? 1 : W;
  // What a line of cells hides of the one before it: the surface, or what is seen behind it.
  std::vector<float> nearer(static_cast<std::size_t>(cells), kNothing), here(nearer);
  const auto at = [&](Index k) {
    return k < 0 || k >= cells ? kNothing : nearer[static_cast<std::size_t>(k)];
  };
  for (Index n = 0; n < lines; ++n) {
    const Index line = along > 0 ? lines - 1 - n : n;
    for (Index k = 0; k < cells; ++k) {
      const Index cell = line * from_line + k * stride;
      const float hidden = between(at(k + aside), at(k + aside + 1), share) - rise,
                  z = surface[cell];
      out[cell] = hidden;
      here[static_cast<std::size_t>(k)] = std::isfinite(z) ? std::max(z, hidden) : hidden;
    }
    std::swap(nearer, here);
  }
  return out;
}

}  // namespace satsurf::reconstruct

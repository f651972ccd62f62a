// SPDX-License-Identifier: Apache-2.0
#include "satsurf/reconstruct/horizon.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <vector>

namespace satsurf::reconstruct {

Tensor horizon(const Tensor& surface, double step, const std::array<double, 2>& to_camera) {
  Dims dim("horizon");
  dim.match("surface", surface, "H W");
  constexpr float kNothing = -std::numeric_limits<float>::infinity();
  Tensor out(surface.shape(), kNothing);
  // rows and columns that a line to the camera passes per metre of height
  const double rows = -to_camera[1] / step, columns = to_camera[0] / step;
  const bool along_rows = std::abs(rows) > std::abs(columns);
  const double fast = along_rows ? rows : columns, slow = along_rows ? columns : rows;
  if (std::abs(fast) < 1e-9) return out;

  // Chains begin at the edge on the camera's side, n = 0, and take one step away from it at a time.
  const Index H = dim["H"], W = dim["W"], length = along_rows ? H : W, width = along_rows ? W : H,
              fast_stride = along_rows ? W : 1, slow_stride = along_rows ? 1 : W;
  std::vector<Index> aside(static_cast<std::size_t>(length));
  for (Index n = 0; n < length; ++n)
    aside[static_cast<std::size_t>(n)] =
        std::lround(-static_cast<double>(n) * slow / std::abs(fast));
  const Index shift = aside.back(), first = std::min<Index>(0, -shift),
              last = width + std::max<Index>(0, -shift);
  const double rise = 1 / std::abs(fast);  // m per step
  constexpr Index kGrain = 16;
  for_range(last - first, kGrain, [&](Index begin, Index end) {
    for (Index line = first + begin; line < first + end; ++line) {
      double highest = -std::numeric_limits<double>::infinity();  // above the chain's slope
      for (Index n = 0; n < length; ++n) {
        const Index s = line + aside[static_cast<std::size_t>(n)];
        if (s < 0 || s >= width) continue;
        const Index f = fast > 0 ? length - 1 - n : n, cell = f * fast_stride + s * slow_stride;
        const double slope = static_cast<double>(n) * rise;
        out[cell] = static_cast<float>(highest - slope);
        if (const float z = surface[cell]; std::isfinite(z))
          highest = std::max(highest, static_cast<double>(z) + slope);
      }
    }
  });
  return out;
}

}  // namespace satsurf::reconstruct

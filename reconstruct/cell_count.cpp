// SPDX-License-Identifier: Apache-2.0
#include "satsurf/reconstruct/cell_count.h"

#include "satsurf/core/parallel.h"
#include "satsurf/reconstruct/shown_place.h"

#include <cmath>
#include <cstddef>

namespace satsurf::reconstruct {
CellCount count_cells(const scene::HeightField& surface, const std::vector<nn::PosedImage>& images,
                      double middle, const Tensor& unwanted) {
  const Index H = surface.z.dim(0), W = surface.z.dim(1);
  std::vector<CellCount> rows(static_cast<std::size_t>(H));
  for_each_index(H, [&](Index row) {
    CellCount& count = rows[static_cast<std::size_t>(row)];
    const double y = surface.y0 - (static_cast<double>(row) + 0.5) * surface.step;
    for (Index column = 0; column < W; ++column) {
      const Index i = row * W + column;
      if (!unwanted.empty() && unwanted[i] > 0) continue;
      const double x = surface.x0 + (static_cast<double>(column) + 0.5) * surface.step;
      const bool has = std::isfinite(surface.z[i]);
      count.found += has ? 1 : 0;
      count.expected += has || shown_by_two(images, x, y, middle) ? 1 : 0;
    }
  });
  CellCount all;
  for (const CellCount& row : rows) all.found += row.found, all.expected += row.expected;
  return all;
}

}  // namespace satsurf::reconstruct

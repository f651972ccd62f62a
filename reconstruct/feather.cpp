// SPDX-License-Identifier: Apache-2.0
#include "satsurf/reconstruct/feather.h"

#include "satsurf/core/error.h"

#include <algorithm>
#include <cmath>

namespace satsurf::reconstruct {

double feather(Index cell, Index begin, Index end, Index cells, Index overlap) {
  const auto ramp = [&](Index from) {  // cells from where the other tile begins to fade
    return std::clamp((static_cast<double>(from) + 0.5) / (2 * static_cast<double>(overlap)), 0.0,
                      1.0);
  };
  const double west = begin == 0 || overlap == 0 ? 1 : ramp(cell - (begin - overlap)),
               east = end == cells || overlap == 0 ? 1 : ramp(end + overlap - 1 - cell);
  return std::min(west, east);
}

FeatheredRows::FeatheredRows(const Tiling& tiling) : tiling_(tiling) {}

void FeatheredRows::add(const Tile& tile, const Tensor& values) {
  const CellRect& all = tile.all;
  if (values.shape() != Shape{all.height(), all.width()} || all.y0 < first_)
    throw ShapeError("FeatheredRows: values " + values.shape().str() + " from row " +
                     std::to_string(all.y0) + ", expected [" + std::to_string(all.height()) + ' ' +
                     std::to_string(all.width()) + "] from row " + std::to_string(first_) + " on");
  const Index W = tiling_.grid.width, H = tiling_.grid.height, m = tiling_.overlap;
  const auto needed = static_cast<std::size_t>((all.y1 - first_) * W);
  if (sum_.size() < needed) sum_.resize(needed, 0), weight_.resize(needed, 0);
  for (Index y = all.y0; y < all.y1; ++y) {
    const double down = feather(y, tile.core.y0, tile.core.y1, H, m);
    for (Index x = all.x0; x < all.x1; ++x) {
      const float v = values[(y - all.y0) * all.width() + x - all.x0];
      if (!std::isfinite(v)) continue;
      const auto w = static_cast<float>(down * feather(x, tile.core.x0, tile.core.x1, W, m));
      const auto at = static_cast<std::size_t>((y - first_) * W + x);
      sum_[at] += w * v, weight_[at] += w;
    }
  }
}

Tensor FeatheredRows::finished(Index tile_row) {
  const Index W = tiling_.grid.width;
  const CellRect& core = tiling_.tiles[static_cast<std::size_t>(tile_row * tiling_.columns)].core;
  const Index end = tile_row + 1 == tiling_.rows ? core.y1 : core.y1 - tiling_.overlap,
              rows = end - first_;
  const auto cells = static_cast<std::size_t>(rows * W);
  if (sum_.size() < cells) sum_.resize(cells, 0), weight_.resize(cells, 0);  // nothing came
  auto out = Tensor::uninitialised({rows, W});
  for (std::size_t i = 0; i < cells; ++i)
    out[static_cast<Index>(i)] = weight_[i] > 0 ? sum_[i] / weight_[i] : std::nanf("");
  sum_.erase(sum_.begin(), sum_.begin() + static_cast<std::ptrdiff_t>(cells));
  weight_.erase(weight_.begin(), weight_.begin() + static_cast<std::ptrdiff_t>(cells));
  first_ = end;
  return out;
}

}  // namespace satsurf::reconstruct

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/reconstruct/feather.h"

#include "satsurf/core/error.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <string>

namespace satsurf::reconstruct {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

}  // namespace

FeatheredRows::FeatheredRows(const Tiling& tiling) : tiling_(tiling) {}

void FeatheredRows::add(const Tile& tile, const Tensor& values) {
  const CellRect& all = tile.all;
  if (values.shape() != Shape{all.height(), all.width()} || all.y0 < first_)
    throw ShapeError("FeatheredRows: values " + values.shape().str() + " from row " +
                     std::to_string(all.y0) + ", expected [" + std::to_string(all.height()) + ' ' +
                     std::to_string(all.width()) + "] from row " + std::to_string(first_) + " on");
  const Index W = tiling_.grid.width;
  const auto needed = static_cast<std::size_t>((all.y1 - first_) * W);
  if (sum_.size() < needed) sum_.resize(needed, 0), weight_.resize(needed, 0);
  for (Index y = all.y0; y < all.y1; ++y)
    for (Index x = all.x0; x < all.x1; ++x) {
      const float v = values[(y - all.y0) * all.width() + x - all.x0];
      if (!std::isfinite(v)) continue;
      const auto w = static_cast<float>(tiling_.weight(tile, x, y));
      const auto at = static_cast<std::size_t>((y - first_) * W + x);
      sum_[at] += w * v, weight_[at] += w;
    }
}

Tensor FeatheredRows::finished(Index end) {
  const Index W = tiling_.grid.width, rows = end - first_;
  const auto cells = static_cast<std::size_t>(rows * W);
  if (sum_.size() < cells) sum_.resize(cells, 0), weight_.resize(cells, 0);  // nothing came
  auto out = Tensor::uninitialised({rows, W});
  for (std::size_t i = 0; i < cells; ++i)
    out[static_cast<Index>(i)] = weight_[i] > 0 ? sum_[i] / weight_[i] : kNan;
  sum_.erase(sum_.begin(), sum_.begin() + static_cast<std::ptrdiff_t>(cells));
  weight_.erase(weight_.begin(), weight_.begin() + static_cast<std::ptrdiff_t>(cells));
  first_ = end;
  return out;
}

OwnedRows::OwnedRows(const Tiling& tiling, Index channels)
    : tiling_(tiling), values_(static_cast<std::size_t>(channels)) {}

void OwnedRows::add(const Tile& tile, const Tensor& values) {
  const CellRect& all = tile.all;
  const auto C = static_cast<Index>(values_.size());
  if (values.shape() != Shape{C, all.height(), all.width()} || all.y0 < first_)
    throw ShapeError("OwnedRows: values " + values.shape().str() + " from row " +
                     std::to_string(all.y0) + ", expected " +
                     Shape{C, all.height(), all.width()}.str() + " from row " +
                     std::to_string(first_) + " on");
  const Index W = tiling_.grid.width;
  const auto needed = static_cast<std::size_t>((all.y1 - first_) * W);
  for (auto& channel : values_)
    if (channel.size() < needed) channel.resize(needed, kNan);
  for (Index y = all.y0; y < all.y1; ++y)
    for (Index x = all.x0; x < all.x1; ++x) {
      const auto at = static_cast<std::size_t>((y - first_) * W + x);
      const float* from = values.data() + (y - all.y0) * all.width() + x - all.x0;
      if (!std::isfinite(*from)) continue;
      if (!tiling_.owns(tile, x, y) &&
          (std::isfinite(values_[0][at]) || !(static_cast<float>(tiling_.weight(tile, x, y)) > 0)))
        continue;
      for (Index c = 0; c < C; ++c)
        values_[static_cast<std::size_t>(c)][at] = from[c * all.height() * all.width()];
    }
}

Tensor OwnedRows::finished(Index end) {
  const Index W = tiling_.grid.width, rows = end - first_, cells = rows * W;
  auto out = Tensor::uninitialised({static_cast<Index>(values_.size()), rows, W});
  for (std::size_t c = 0; c < values_.size(); ++c) {
    auto& channel = values_[c];
    if (channel.size() < static_cast<std::size_t>(cells))
      channel.resize(static_cast<std::size_t>(cells), kNan);
    std::copy_n(channel.begin(), cells, out.data() + static_cast<Index>(c) * cells);
    channel.erase(channel.begin(), channel.begin() + cells);
  }
  first_ = end;
  return out;
}

std::vector<std::size_t> assembly_order(const Tiling& tiling) {
  std::vector<std::size_t> order(tiling.tiles.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::ranges::stable_sort(order, {}, [&](std::size_t k) { return tiling.tiles[k].all.y0; });
  return order;
}

}  // namespace satsurf::reconstruct

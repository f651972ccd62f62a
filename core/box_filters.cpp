// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/box_filters.h"

#include "satsurf/core/parallel.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <vector>

namespace satsurf {
namespace {

/// The largest of every `length` neighbours of several sequences side by side, in their first n places.
/// Stretches of twice the length from two of half of it, and the last from two that overlap.
/// values  [n + length - 1, lanes]
void slide_max(std::vector<float>& values, Index n, Index length, Index lanes) {
  float* v = values.data();
  const auto join = [&](Index places, Index apart) {
    const Index shift = apart * lanes;
    for (Index i = 0; i < places * lanes; ++i) v[i] = std::max(v[i], v[i + shift]);
  };
  Index reach = 1;
  for (; 2 * reach <= length; reach *= 2) join(n + length - 2 * reach, reach);
  if (reach < length) join(n, length - reach);
}

/// Rows whose sums go on side by side: one alone waits for each addition.
constexpr Index kTogether = 4;

/// Means of 2 radius + 1 neighbours, cut off at the ends.
/// from, to  [R W]
template <Index R>
void mean_along(const float* from, Index W, Index radius, float* to) {
  std::array<double, R> sum{};
  Index count = std::min(radius, W);
  const auto add = [&](Index j, double sign) {
    for (Index r = 0; r < R; ++r)
      sum[static_cast<std::size_t>(r)] += sign * static_cast<double>(from[r * W + j]);
  };
  for (Index j = 0; j < count; ++j) add(j, 1.0);
  for (Index j = 0; j < W; ++j) {
    if (j + radius < W) add(j + radius, 1.0), ++count;
    if (j > radius) add(j - radius - 1, -1.0), --count;
    for (Index r = 0; r < R; ++r)
      to[r * W + j] =
          static_cast<float>(sum[static_cast<std::size_t>(r)] / static_cast<double>(count));
  }
}

}  // namespace

Tensor box_mean(const Tensor& grid, Index radius) {
  const Index H = grid.dim(0), W = grid.dim(1);
  auto rows = Tensor::uninitialised({H, W}), out = Tensor::uninitialised({H, W});
  for_range(H, 32, [&](Index begin, Index end) {
    Index i = begin;
    for (; i + kTogether <= end; i += kTogether)
      mean_along<kTogether>(grid.data() + i * W, W, radius, rows.data() + i * W);
    for (; i < end; ++i) mean_along<1>(grid.data() + i * W, W, radius, rows.data() + i * W);
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

Tensor box_max(const Tensor& grid, Index radius) {
  const Index H = grid.dim(0), W = grid.dim(1), length = 2 * radius + 1;
  auto rows = Tensor::uninitialised({H, W}), out = Tensor::uninitialised({H, W});
  for_range(H, 32, [&](Index begin, Index end) {
    std::vector<float> line;
    for (Index i = begin; i < end; ++i) {
      line.assign(static_cast<std::size_t>(W + length - 1), -INFINITY);
      std::copy_n(grid.data() + i * W, W, line.begin() + radius);
      slide_max(line, W, length, 1);
      std::copy_n(line.begin(), W, rows.data() + i * W);
    }
  });
  constexpr Index kLanes = 64;
  for_range(W, kLanes, [&](Index begin, Index end) {
    const Index lanes = end - begin;
    std::vector<float> lines(static_cast<std::size_t>((H + length - 1) * lanes), -INFINITY);
    for (Index i = 0; i < H; ++i)
      std::copy_n(rows.data() + i * W + begin, lanes, lines.begin() + (i + radius) * lanes);
    slide_max(lines, H, length, lanes);
    for (Index i = 0; i < H; ++i)
      std::copy_n(lines.begin() + i * lanes, lanes, out.data() + i * W + begin);
  });
  return out;
}

}  // namespace satsurf

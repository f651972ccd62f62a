// SPDX-License-Identifier: Apache-2.0
#include "satsurf/reconstruct/untextured.h"

#include "satsurf/core/box_filters.h"
#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"
#include "satsurf/reconstruct/cell_links.h"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

namespace satsurf::reconstruct {
namespace {

constexpr double kRadius = 5;             // m, half a square
constexpr float kUntextured = 0.03f;      // standard deviation of log colours
constexpr float kLeastShare = 0.2f;       // of a square's cells that are in doubt
constexpr double kDoubt = 1, kWhole = 2;  // expected errors, m
constexpr double kPull = 30;              // of neighbours, m^-2
constexpr double kLeastPull = 1e-3;       // m^-2, below which neighbours are none
constexpr double kColour = 0.04;          // difference of log colours at an edge
constexpr double kEdge = 3;               // m
constexpr double kLeastSigma = 0.15;      // m, less is too good to be true
constexpr int kPasses = 3;

/// Calls `of` with every index below n.
template <class Of>
void for_each_cell(Index n, const Of& of) {
  for_range(n, 1 << 14, [&](Index begin, Index end) {
    for (Index i = begin; i < end; ++i) of(i);
  });
}

/// How much each cell is in doubt where it is untextured, 0 to 1.
/// known  [H W] 1 where there is a height, else 0
Tensor doubt_of(const Tensor& known, const Tensor& sigma, const Tensor& colours, double step) {
  const Shape& shape = known.shape();
  const Index P = known.count(), radius = std::max<Index>(1, std::lround(kRadius / step));
  Tensor out(shape), in_doubt(shape);
  for_each_cell(P, [&](Index i) {
    if (!(known[i] > 0)) return;
    out[i] = static_cast<float>(
        std::clamp((static_cast<double>(sigma[i]) - kDoubt) / (kWhole - kDoubt), 0., 1.));
    in_doubt[i] = out[i] > 0;
  });
  const Tensor count = box_mean(known, radius), doubtful = box_mean(in_doubt, radius);
  Tensor alike(shape);  // 1 in the middle of such squares
  for_each_cell(P,
                [&](Index i) { alike[i] = count[i] > 0 && doubtful[i] >= kLeastShare * count[i]; });
  for (Index c = 0; c < colours.dim(0); ++c) {
    Tensor value(shape), square(shape);
    for_each_cell(P, [&](Index i) {
      if (!(known[i] > 0)) return;
      value[i] = colours[c * P + i];
      square[i] = value[i] * value[i];
    });
    const Tensor sum = box_mean(value, radius), squares = box_mean(square, radius);
    for_each_cell(P, [&](Index i) {
      const float mean = sum[i] / count[i];
      if (squares[i] / count[i] - mean * mean > kUntextured * kUntextured) alike[i] = 0;
    });
  }
  const Tensor near = box_max(alike, radius);
  for_each_cell(P, [&](Index i) {
    if (!(near[i] > 0)) out[i] = 0;
  });
  return out;
}

/// Neighbours, and what draws them together but for what their heights say, m^-2.
std::vector<CellLink> links_of(const Tensor& doubt, const Tensor& known, const Tensor& colours) {
  const Index H = doubt.dim(0), W = doubt.dim(1), P = H * W;
  std::vector<CellLink> out;
  const auto link = [&](Index a, Index b) {
    const float g = std::max(doubt[a], doubt[b]);
    if (!(g > 0 && known[a] > 0 && known[b] > 0)) return;
    double apart = 0;
    for (Index c = 0; c < colours.dim(0); ++c)
      apart =
          std::max(apart, static_cast<double>(std::abs(colours[c * P + a] - colours[c * P + b])));
    const double pull =
        kPull * static_cast<double>(g) * std::exp(-apart * apart / (kColour * kColour));
    if (pull > kLeastPull) out.push_back({a, b, pull});
  };
  for (Index y = 0; y < H; ++y)
    for (Index x = 0; x < W; ++x) {
      const Index i = y * W + x;
      if (x + 1 < W) link(i, i + 1);
      if (y + 1 < H) link(i, i + W);
    }
  return out;
}

/// Gives the cells of links numbers from 0, in their order, and the links these for the cells'.
/// returns  each number's cell
std::vector<Index> numbered(std::vector<CellLink>& links, Index cells) {
  std::vector<Index> number(static_cast<std::size_t>(cells), -1), out;
  const auto of = [&](Index cell) -> Index& { return number[static_cast<std::size_t>(cell)]; };
  for (const CellLink& l : links) of(l.a) = of(l.b) = 0;
  for (Index i = 0; i < cells; ++i)
    if (of(i) == 0) of(i) = std::ssize(out), out.push_back(i);
  for (CellLink& l : links) l.a = of(l.a), l.b = of(l.b);
  return out;
}

/// The links at heights z: the steeper, the weaker.
std::vector<CellLink> on_heights(std::vector<CellLink> links, const Eigen::VectorXd& z) {
  for (CellLink& l : links) {
    const double rise = (z[l.a] - z[l.b]) / kEdge, flat = 1 + rise * rise;
    l.pull /= flat * flat;
  }
  return links;
}

}  // namespace

Index even_untextured(Tensor& heights, Tensor& sigma, const Tensor& colours, double step) {
  Dims dim("even_untextured");
  dim.match("heights", heights, "H W").match("sigma", sigma, "H W");
  dim.match("colours", colours, "C H W");
  Tensor known(heights.shape());
  for_each_cell(heights.count(), [&](Index i) { known[i] = std::isfinite(heights[i]); });
  const Tensor doubt = doubt_of(known, sigma, colours, step);
  std::vector<CellLink> links = links_of(doubt, known, colours);
  const std::vector<Index> cells = numbered(links, heights.count());
  if (cells.empty()) return 0;

  const Eigen::Index N = std::ssize(cells);
  Eigen::VectorXd found(N), expected(N), weight(N);
  for (Eigen::Index n = 0; n < N; ++n) {
    const Index i = cells[static_cast<std::size_t>(n)];
    found[n] = static_cast<double>(heights[i]), expected[n] = static_cast<double>(sigma[i]);
    const double s = std::max(expected[n], kLeastSigma);
    weight[n] = 1 / (s * s);
  }
  Eigen::VectorXd z = found, error = expected;
  for (int pass = 0; pass < kPasses; ++pass) {
    const LinkedCells linked(cells, heights.dim(1), on_heights(links, z), weight);
    z = linked.evened(found, z);
    if (pass + 1 == kPasses) error = linked.evened(expected, error);
  }
  Index evened = 0;
  for (Eigen::Index n = 0; n < N; ++n) {
    const Index i = cells[static_cast<std::size_t>(n)];
    heights[i] = static_cast<float>(z[n]), sigma[i] = static_cast<float>(error[n]);
    evened += doubt[i] > 0;
  }
  return evened;
}

}  // namespace satsurf::reconstruct

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/evaluate/fill.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"

#include <cmath>
#include <cstdint>
#include <vector>

namespace satsurf::evaluate {
namespace {

constexpr std::int32_t kNone = -1;

/// For every cell the nearest row with a known cell in its column, looking one way, its own
/// included.
/// first, last, step  rows in the order in which they learn of each other
std::vector<std::int32_t> nearest_rows(const Tensor& z, Index first, Index last, Index step) {
  const Index W = z.dim(1);
  std::vector<std::int32_t> row(static_cast<std::size_t>(z.count()), kNone);
  for (Index i = first; i != last; i += step)
    for (Index j = 0; j < W; ++j) {
      const auto k = static_cast<std::size_t>(i * W + j);
      if (std::isfinite(z[i * W + j]))
        row[k] = static_cast<std::int32_t>(i);
      else if (i != first)
        row[k] = row[static_cast<std::size_t>((i - step) * W + j)];
    }
  return row;
}

/// Weighted sums for the cells of a row, and room to work in.
struct RowSums {
  std::vector<double> sum, weight;
  std::vector<Index> queue;
  explicit RowSums(Index W)
      : sum(static_cast<std::size_t>(W)), weight(sum.size()), queue(sum.size()) {}
};

/// Adds the nearest known cell of one quadrant to each unknown cell of row i, in time O(W).
/// The columns are swept towards the cell, so that they enter the quadrant one by one. The squared
/// distance to a column's nearest cell is (t - p)^2 + d^2, where t is the sweep's position and p that
/// of the column; from some t on a later column is nearer than an earlier one, and stays so. Those
/// that are the nearest at any t wait in a queue.
/// rows       [W] nearest known rows on the quadrant's side of row i; nullptr for none
/// direction  of the quadrant's columns: 1 east, -1 west
/// start      1 to leave the cell's own column out, else 0
void add_quadrant(const Tensor& z, Index i, const std::int32_t* rows, Index direction, Index start,
                  RowSums& out) {
  if (rows == nullptr) return;
  const Index W = z.dim(1);
  const auto column = [&](Index p) { return direction > 0 ? W - 1 - p : p; };
  const auto offset = [&](Index p) { return rows[column(p)] - i; };
  const auto square = [&](Index t, Index p) { return (t - p) * (t - p) + offset(p) * offset(p); };
  // b is as near as a from t = crossing / (2 (b - a)) on
  const auto crossing = [&](Index a, Index b) { return square(0, b) - square(0, a); };
  Index* queue = out.queue.data();
  Index head = 0, tail = 0;
  for (Index t = 0; t < W; ++t) {
    const Index p = t - start;
    if (p >= 0 && rows[column(p)] != kNone) {
      while (tail - head > 1) {  // whoever is overtaken before it overtakes is never the nearest
        const Index a = queue[tail - 2], b = queue[tail - 1];
        if (crossing(a, b) * (p - b) < crossing(b, p) * (b - a)) break;
        --tail;
      }
      queue[tail++] = p;
    }
    const Index j = column(t);
    if (head == tail || std::isfinite(z[i * W + j])) continue;
    while (tail - head > 1 && square(t, queue[head + 1]) <= square(t, queue[head])) ++head;
    const Index nearest = column(queue[head]);
    const auto weight = 1 / static_cast<double>(square(t, queue[head]));
    out.sum[static_cast<std::size_t>(j)] +=
        weight * static_cast<double>(z[rows[nearest] * W + nearest]);
    out.weight[static_cast<std::size_t>(j)] += weight;
  }
}

}  // namespace

Tensor filled(const Tensor& z) {
  Dims dim("filled");
  dim.match("z", z, "H W");
  const Index H = dim["H"], W = dim["W"];
  const std::vector<std::int32_t> north = nearest_rows(z, 0, H, 1),
                                  south = nearest_rows(z, H - 1, -1, -1);
  const auto row_of = [&](const std::vector<std::int32_t>& rows, Index i) {
    return i >= 0 && i < H ? rows.data() + i * W : nullptr;
  };
  Tensor out = z.clone();
  for_range(H, 8, [&](Index begin, Index end) {
    for (Index i = begin; i < end; ++i) {
      RowSums sums(W);
      add_quadrant(z, i, row_of(north, i - 1), 1, 0,
                   sums);  // each a quarter turn of the one before
      add_quadrant(z, i, row_of(south, i), 1, 1, sums);
      add_quadrant(z, i, row_of(south, i + 1), -1, 0, sums);
      add_quadrant(z, i, row_of(north, i), -1, 1, sums);
      for (Index j = 0; j < W; ++j) {
        const auto k = static_cast<std::size_t>(j);
        if (sums.weight[k] > 0) out[i * W + j] = static_cast<float>(sums.sum[k] / sums.weight[k]);
      }
    }
  });
  return out;
}

}  // namespace satsurf::evaluate

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/reconstruct/tile_cut.h"

#include <algorithm>

namespace satsurf::reconstruct {
namespace {

constexpr double kLocal = 0.2;  // of a window at most, for the parallax of a tile's heights

/// One axis of a view's window: pixels along it that a column and a row of the surface's cells take,
/// and how many of them cells may take, the rest being for the heights.
struct Axis {
  double column = 0, row = 0, room = 0;
  bool upright = false;  ///< the window's rows, north up
};

/// Parts of a side whose cores leave room for the overlap.
/// most  cells of a part
Index parts_of(Index cells, double most, Index overlap) {
  if (static_cast<double>(cells) <= most) return 1;
  // A window of NaN holds no cell.
  const auto core = most >= static_cast<double>(4 * overlap)
                        ? static_cast<Index>(most) - 2 * overlap
                        : 2 * overlap;
  return (cells + core - 1) / core;
}

/// The axes of all windows when tiles lie along `axes`.
std::vector<Axis> window_axes(const CutRules& rules, const TileAxes& axes) {
  const auto S = static_cast<double>(rules.window - kWindowSlack);
  std::vector<Axis> out;
  for (const rpc::PixelJacobian& camera : rules.cameras)
    for (std::size_t k = 0; k < 2; ++k) {
      const auto [east, north, up] = camera[k];
      const auto [column, row] = axes.along(east, -north);
      out.push_back({std::abs(column) * rules.grid.step, std::abs(row) * rules.grid.step,
                     std::max(S - std::abs(up) * rules.z_span, (1 - kLocal) * S),
                     k == upright_row(camera)});
    }
  return out;
}

}  // namespace

std::size_t upright_row(const rpc::PixelJacobian& camera) {
  return std::abs(camera[1][1]) >= std::abs(camera[0][1]) ? 1 : 0;
}

double Cut::boundary(std::size_t axis, Index k) const {
  const Index side = end[axis] - begin[axis], parts = axis == 0 ? columns : rows;
  return axes.sine == 0
             ? static_cast<double>(begin[axis] + side * k / parts)
             : static_cast<double>(begin[axis]) +
                   static_cast<double>(side) * static_cast<double>(k) / static_cast<double>(parts);
}

double Cut::cells_of_tile(Index overlap) const {
  std::array<double, 2> side{};
  for (std::size_t k = 0; k < 2; ++k) {
    const Index parts = k == 0 ? columns : rows;
    side[k] = static_cast<double>(end[k] - begin[k]) / static_cast<double>(parts) +
              static_cast<double>(parts > 1 ? 2 * overlap : 0);
  }
  const double c = std::abs(axes.cosine), t = std::abs(axes.sine);
  return (c * side[0] + t * side[1]) * (t * side[0] + c * side[1]);
}

Cut best_cut(const CutRules& rules, const TileAxes& turned) {
  // Of the time of a tile; the surface is made of the upright rectangle around it.
  constexpr double kSurface = 0.2;
  constexpr Index kTried = 64;  // numbers of columns, for each multiple of the fewest
  Cut best{.axes = turned};
  if (turned.sine == 0) {
    best.end = {rules.grid.width, rules.grid.height};
  } else {
    std::array<double, 2> least{INFINITY, INFINITY}, most{-INFINITY, -INFINITY};
    for (const auto& [x, y] : rules.seen) {
      const auto at = turned.along((x - rules.grid.east) / rules.grid.step,
                                   (rules.grid.north - y) / rules.grid.step);
      for (std::size_t k = 0; k < 2; ++k)
        least[k] = std::min(least[k], at[k]), most[k] = std::max(most[k], at[k]);
    }
    for (std::size_t k = 0; k < 2; ++k)
      best.begin[k] = static_cast<Index>(std::floor(least[k])),
      best.end[k] = static_cast<Index>(std::ceil(most[k]));
  }
  const std::vector<Axis> axes = window_axes(rules, turned);
  const Index wide_cells = best.end[0] - best.begin[0], high_cells = best.end[1] - best.begin[1],
              overlap = rules.overlap;
  const auto cells_of = [&](Index side, Index parts) {
    return static_cast<double>(side) / static_cast<double>(parts) +
           static_cast<double>(parts > 1 ? 2 * overlap : 0);
  };
  double widest = INFINITY;
  for (const Axis& axis : axes) widest = std::min(widest, axis.room / axis.column);
  const Index first = parts_of(wide_cells, widest, overlap);
  const Index step = std::max<Index>(1, first / kTried);
  for (Index columns = first; columns <= 4 * first + 4; columns += step) {
    const double wide = cells_of(wide_cells, columns);
    double highest = INFINITY;
    for (const Axis& axis : axes)
      highest = std::min(highest, (axis.room - axis.column * wide) / axis.row);
    const Index rows = parts_of(high_cells, highest, overlap);
    const double high = cells_of(high_cells, rows);
    std::array<double, 2> side{};
    for (const Axis& axis : axes) {
      double& of = side[axis.upright ? 1 : 0];
      of = std::max(
          of, axis.column * wide + axis.row * high + static_cast<double>(rules.window) - axis.room);
    }
    const double of = static_cast<double>(rules.multiple);
    const double cost = static_cast<double>(columns) * static_cast<double>(rows) *
                        std::ceil(side[0] / of) * std::ceil(side[1] / of) *
                        (1 + kSurface * (turned.spread() - 1));
    if (cost < best.cost || best.rows == 0)
      best.cost = cost, best.columns = columns, best.rows = rows;
    if (2 * overlap >= wide_cells / columns || static_cast<double>(columns) > kMostTiles) break;
  }
  return best;
}

Cut best_direction(const CutRules& rules) {
  constexpr double kWorth = 0.95;
  const Cut upright = best_cut(rules, {});
  if (static_cast<double>(upright.columns) * static_cast<double>(upright.rows) > kMostTiles ||
      rules.seen.empty())
    return upright;
  Cut best;
  for (int degrees = -44; degrees <= 45; ++degrees)
    if (const Cut cut = best_cut(rules, TileAxes::turned(degrees)); cut.cost < best.cost)
      best = cut;
  return best.cost < kWorth * upright.cost ? best : upright;
}

}  // namespace satsurf::reconstruct

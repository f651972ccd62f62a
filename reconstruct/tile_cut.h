// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/reconstruct/tiling.h"
#include "satsurf/rpc/fit.h"
#include "satsurf/scene/polygon.h"

#include <array>
#include <cmath>
#include <vector>

namespace satsurf::reconstruct {

inline constexpr double kMostTiles = 1e6;
inline constexpr Index kWindowSlack = 8;  ///< px of a window for rounding and interpolation

/// Which row of a camera's derivatives is the axis of north, see `scene::quarters_to_north`.
std::size_t upright_row(const rpc::PixelJacobian& camera);

/// How tiles along some axes are cut, of what is seen of a grid.
struct Cut {
  TileAxes axes;
  std::array<Index, 2> begin{}, end{};  ///< of all tiles, along both axes, cells
  Index columns = 1, rows = 0;
  double cost = INFINITY;  ///< pixels of the windows of one view, and what cells beside tiles take

  /// Where the parts of a side begin and end.
  double boundary(std::size_t axis, Index k) const;
  /// Of the upright rectangle around a tile and what it shares.
  double cells_of_tile(Index overlap) const;
};

/// What tiles are cut for.
struct CutRules {
  Grid grid;
  const std::vector<rpc::PixelJacobian>& cameras;  ///< of the views, in the middle of the ground
  const scene::Polygon& seen;                      ///< of the ground, local m
  double z_span = 0;                               ///< of the heights, m
  Index overlap = 0;                               ///< cells
  Index window = 0, multiple = 1;  ///< largest side of windows, what theirs are multiples of, px
};

/// The columns and rows of tiles along some axes that need the fewest pixels of windows. Tiles are the
/// longer, the less of the window the heights take along them.
Cut best_cut(const CutRules& rules, const TileAxes& axes);
/// The best of all directions, or that of the grid where hardly any is better.
Cut best_direction(const CutRules& rules);

}  // namespace satsurf::reconstruct

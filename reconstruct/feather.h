// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/reconstruct/tiling.h"

#include <vector>

namespace satsurf::reconstruct {

/// Weight of a cell of a tile along one axis: one in the middle, falling linearly to zero across the
/// overlap with a neighbour, so that the weights of two neighbours add up to one.
/// cell        of the grid
/// begin, end  of the tile's core
/// cells       of the grid along the axis: its rim has no neighbour
double feather(Index cell, Index begin, Index end, Index cells, Index overlap);

/// Blends the rasters of tiles, row of tiles by row of tiles, and gives back the rows of the whole
/// that no later tile reaches. Unknown cells of one tile leave the cell to the others.
class FeatheredRows {
 public:
  explicit FeatheredRows(const Tiling& tiling);
  /// values  [h w] of all cells of the tile; the tiles come row by row
  void add(const Tile& tile, const Tensor& values);
  /// Ends a row of tiles.
  /// returns  the rows from the last ones given on that are finished, [n W]
  Tensor finished(Index tile_row);

 private:
  const Tiling& tiling_;
  Index first_ = 0;  ///< row of the grid that `sum_` begins with
  std::vector<float> sum_, weight_;
};

}  // namespace satsurf::reconstruct

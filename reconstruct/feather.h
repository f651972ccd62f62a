// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/reconstruct/tiling.h"

#include <cstddef>
#include <vector>

namespace satsurf::reconstruct {

/// Blends the rasters of tiles as `Tiling::weight` says and gives the rows of the whole back from
/// north to south. Unknown cells of one tile leave the cell to the others.
class FeatheredRows {
 public:
  explicit FeatheredRows(const Tiling& tiling);
  /// values  [h w] of all cells of the tile, of which none lies in rows that were given back
  void add(const Tile& tile, const Tensor& values);
  /// The rows from the last ones given back to `end`, which no later tile reaches, [n W].
  Tensor finished(Index end);

 private:
  const Tiling& tiling_;
  Index first_ = 0;  ///< row of the grid that `sum_` begins with
  std::vector<float> sum_, weight_;
};

/// Puts the rasters of tiles beside one another, each in the cells that it answers for. What the one
/// does not know there another says that is blended in, so that as much is known as of blended rasters.
class OwnedRows {
 public:
  OwnedRows(const Tiling& tiling, Index channels);
  /// values  [C h w] of all cells of the tile, known where the first channel is
  void add(const Tile& tile, const Tensor& values);
  /// As of `FeatheredRows`, [C n W], NaN where no tile knew anything.
  Tensor finished(Index end);

 private:
  const Tiling& tiling_;
  Index first_ = 0;                         ///< row of the grid that `values_` begin with
  std::vector<std::vector<float>> values_;  ///< of each channel
};

/// The order in which tiles are put together so that rows are finished early: from north to south.
std::vector<std::size_t> assembly_order(const Tiling& tiling);

}  // namespace satsurf::reconstruct

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/reconstruct/plan.h"
#include "satsurf/scene/survey.h"

#include <optional>
#include <vector>

namespace satsurf::reconstruct {

/// Cells of a grid: columns x0 to x1 and rows y0 to y1, the last ones not among them.
struct CellRect {
  Index x0 = 0, y0 = 0, x1 = 0, y1 = 0;
  Index width() const { return x1 - x0; }
  Index height() const { return y1 - y0; }
  friend bool operator==(const CellRect&, const CellRect&) = default;
};

/// A part of a surface that is made on its own.
struct Tile {
  Index row = 0, column = 0;  ///< counted from the north-west
  CellRect core;              ///< what it answers for; the cores cover the grid without overlap
  CellRect all;  ///< with what it shares with its neighbours, in which they are blended
};

/// A large surface and the tiles it is made of.
struct Tiling {
  Grid grid;  ///< of the whole surface
  Index rows = 1, columns = 1;
  Index overlap = 0;        ///< cells by which a tile reaches beyond its core
  Index window = 0;         ///< largest side of what the network sees of a view, px
  Index views = 0;          ///< most that it sees of one tile
  std::vector<Tile> tiles;  ///< row by row from the north-west
  double memory_bytes = 0;  ///< of the whole program, within a tenth
  double megapixels = 0;    ///< that the network will see, of all views and tiles together

  /// The cells of a part of the grid.
  Grid grid_of(const CellRect& cells) const;
};

/// Images, as far as memory depends on them.
struct ImageSizes {
  Index views = 0;     ///< of one part of the ground
  Index largest = 0;   ///< longest side, px
  Index surveyed = 0;  ///< of all the ground, whose copies are kept; 0 for no more
};
/// Largest window of any tile, px.
inline constexpr Index kLargestWindow = 2048;

/// Largest window that fits into the memory, up to `kLargestWindow` px.
/// bytes  of the whole program; 0 for as much as windows of `kWholeImage` px take
/// throws  ConfigError where not even the least window fits
Index window_for_memory(const nn::ModelConfig& model, const ImageSizes& images, Surface surface,
                        double bytes);

/// Cuts the ground that two views or more see into tiles, as large as the windows are that the memory
/// holds, so that what every view shows of a tile and of its surroundings, for all heights of the
/// range, lies in one window, and as long and wide as takes the fewest pixels of all windows. Of a
/// wide range up to a fifth of the window counts: the tiles' own ranges are narrower.
/// wanted      the part of the ground to make, all if left out
/// max_memory  bytes of the whole program, 0 for as much as windows of `kWholeImage` px take
/// throws      Error where two views see nothing of the ground that is wanted, or for a million tiles; ConfigError
Tiling plan_tiles(const nn::ModelConfig& model, const scene::Survey& survey,
                  const ReconstructOptions& options, const std::optional<Ground>& wanted,
                  double max_memory);

}  // namespace satsurf::reconstruct

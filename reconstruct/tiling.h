// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/reconstruct/plan.h"
#include "satsurf/scene/survey.h"

#include <array>
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

/// The directions in which tiles lie beside and below one another: those of the grid's columns and
/// rows, turned against them as the images are.
struct TileAxes {
  double cosine = 1, sine = 0;

  static TileAxes turned(double degrees);  ///< clockwise
  /// Where a place lies along both, cells from the grid's north-western corner, and back.
  std::array<double, 2> along(double x, double y) const {
    return {cosine * x + sine * y, cosine * y - sine * x};
  }
  std::array<double, 2> place(double u, double v) const {
    return {cosine * u - sine * v, sine * u + cosine * v};
  }
  double degrees() const;
  /// How many times its cells the upright rectangle around a square tile has.
  double spread() const;
};

/// A part of a surface that is made on its own: the cells whose middles lie in a rectangle along the
/// axes.
struct Tile {
  Index row = 0, column = 0;  ///< counted from the north-west
  CellRect core;              ///< around what it answers for, which no other tile does
  CellRect all;  ///< around that and what it shares with its neighbours, in which they are blended
  std::array<double, 2> begin{}, end{};  ///< of what it answers for, along both axes, cells
};

/// A large surface and the tiles it is made of.
struct Tiling {
  Grid grid;  ///< of the whole surface
  TileAxes axes;
  Index rows = 1, columns = 1;
  Index overlap = 0;                  ///< cells by which a tile reaches beyond its core
  Index window = 0;                   ///< largest side of what the network sees of a view, px
  scene::WindowSize expected_window;  ///< of the largest tile, if its heights are as planned for
  Index views = 0;                    ///< most that it sees of one tile
  std::vector<Tile> tiles;            ///< row by row from the north-west; none beside the grid
  double memory_bytes = 0;            ///< of the whole program, within a tenth
  double megapixels = 0;  ///< that the network will see, of all views and tiles together

  /// The cells of a part of the grid.
  Grid grid_of(const CellRect& cells) const;
  /// A tile that answers for a rectangle along the axes, cells.
  Tile tile(Index row, Index column, const std::array<double, 2>& begin,
            const std::array<double, 2>& end) const;
  /// The corners of what a tile answers for and `margin` cells more on every side, from that of the
  /// first column and the last row on counter-clockwise, local m.
  scene::Polygon corners_of(const Tile& tile, double margin = 0) const;
  /// The ground of a tile with what it shares with its neighbours, local m; empty beside the grid.
  scene::Polygon ground_of(const Tile& tile) const;
  /// Whether a cell, or a place in local m, is the tile's to answer for.
  bool owns(const Tile& tile, Index x, Index y) const;
  bool owns_place(const Tile& tile, double x, double y) const;
  /// What a tile's value counts in a cell: one in its middle, falling linearly to zero across what
  /// it shares with a neighbour, so that the weights of two neighbours add up to one.
  double weight(const Tile& tile, Index x, Index y) const;
};

/// Images, as far as memory depends on them.
struct ImageSizes {
  Index views = 0;      ///< of one part of the ground
  Index largest = 0;    ///< longest side, px
  Index surveyed = 0;   ///< of all the ground, whose copies are kept; 0 for no more
  double parallax = 0;  ///< of a tile's heights, px, see `mean_parallax`
};
/// Largest window of any tile, px.
inline constexpr Index kLargestWindow = 2048;

/// Largest window that fits into the memory, up to `kLargestWindow` px.
/// bytes   of the whole program; 0 for as much as windows of `kWholeImage` px take
/// cells   of the surface for each pixel of a window
/// throws  ConfigError where not even the least window fits
Index window_for_memory(const nn::ModelConfig& model, const ImageSizes& images, Surface surface,
                        double bytes, double cells = 1);

/// Cuts the ground that two views or more see into tiles, as large as the windows are that the memory
/// holds, so that what every view shows of a tile and of its surroundings, for all heights of the
/// range, lies in one window, and as long and wide as takes the fewest pixels of all windows. Of a
/// wide range half as much again as the fewest hypotheses span counts: the tiles' own ranges are narrower,
/// and where one is not, its tile has several windows. Where images
/// are turned against the grid, so are the tiles if that saves a twentieth: the window of an upright
/// tile would show half as much again.
/// options  of which `max_memory` of 0 means as much as windows of `kWholeImage` px take
/// wanted   the part of the ground to make, all if left out
/// throws   Error where two views see nothing of the ground that is wanted, or for a million tiles; ConfigError
Tiling plan_tiles(const nn::ModelConfig& model, const scene::Survey& survey,
                  const ReconstructOptions& options, const std::optional<Ground>& wanted);

}  // namespace satsurf::reconstruct

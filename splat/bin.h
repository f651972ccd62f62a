// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/shape.h"

#include <cstdint>
#include <vector>

namespace satsurf::splat {

/// Side of a square tile, px.
inline constexpr Index kTile = 16;

/// Pixels a surfel may contribute to, both ends included; empty (x1 < x0) for a culled surfel.
struct Box {
  std::int32_t x0 = 0, y0 = 0, x1 = -1, y1 = -1;
};

/// Tiles that a box touches: columns x0..x1-1, rows y0..y1-1.
struct TileSpan {
  Index x0, y0, x1, y1;
  Index count() const { return (x1 - x0) * (y1 - y0); }
};
/// The tiles a box meets; none for an empty box.
inline TileSpan tiles_of(const Box& box) {
  if (box.x1 < box.x0) return {0, 0, 0, 0};
  const auto tile = [](std::int32_t pixel) {  // unsigned: a division by a power of two is a shift
    return static_cast<Index>(static_cast<std::uint32_t>(pixel) /
                              static_cast<std::uint32_t>(kTile));
  };
  return {tile(box.x0), tile(box.y0), tile(box.x1) + 1, tile(box.y1) + 1};
}

/// Surfels of every tile, front to back.
struct TileLists {
  Index columns = 0, rows = 0;
  std::vector<Index> first;           ///< [rows*columns + 1] where each tile's list begins
  std::vector<std::int32_t> surfels;  ///< all lists, one behind the other
  Index count(Index tile) const { return first[tile + 1] - first[tile]; }
};

/// Indices of the surfels with a box, by descending height; equal heights keep their order. On a
/// ray of an affine camera that looks down, the order of heights is the order along the ray, so one
/// sort serves every tile.
/// boxes    of all surfels
/// heights  of surfel i at heights[i * stride], finite where the box is not empty
/// stride   elements between two heights
template <class T>
std::vector<std::int32_t> front_to_back(const std::vector<Box>& boxes, const T* heights,
                                        Index stride);

/// Distributes surfels over the tiles of an image, keeping their order within each tile.
/// boxes          of all surfels
/// order          of those to be drawn, front to back
/// height, width  of the image, px
TileLists bin(const std::vector<Box>& boxes, const std::vector<std::int32_t>& order, Index height,
              Index width);

}  // namespace satsurf::splat

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/reconstruct/outvoted.h"
#include "satsurf/reconstruct/reconstruct.h"
#include "satsurf/reconstruct/tiling.h"

namespace satsurf::reconstruct {

/// What became of one tile.
struct TileSurface {
  bool empty =
      true;  ///< fewer than two views show anything of it, or none of it is wanted; nothing else is set then
  Tensor heights;                  ///< [h w] of all its cells, local z in m, NaN where unknown
  Tensor confidence;               ///< alike
  Tensor sigma;                    ///< alike; empty unless the surface is refined
  Tensor views;                    ///< alike: how many images see the cell
  Tensor ortho;                    ///< [C h w] alike, as `orthophoto`; empty where nothing is seen
  splat::Surfels surfels;          ///< those over its core and inside; without tensors for none
  rpc::HeightRange z_range;        ///< that was searched, local m
  scene::WindowSize window;        ///< what the network saw of each view, px
  Index found = 0;                 ///< cells of the core, and inside, with a height
  Index expected = 0;              ///< and those two views show
  Index compared = 0, agreed = 0;  ///< see Reconstruction
  Index levelled = 0, evened = 0;  ///< cells, of the core and what it shares, see Reconstruction
  double camera_fit_max_px = 0;
};

/// How many cells of a tile's core two of its views or more show in the middle of the heights, of those
/// inside and on ground that is wanted: what there is to find.
/// part, options, inside  as of `reconstruct_tile`
Index cells_to_find(const scene::WindowedScene& part, const Tiling& tiling, const Tile& tile,
                    const ReconstructOptions& options,
                    const std::function<Tensor(const Grid&)>& inside = {});

/// Makes the surface of one tile.
/// part       of the scene that shows it
/// exposures  of all images of the survey
/// options    of the whole; grid, window and range are the tile's
/// inside     says of cells, [H W], which lie in what is asked for, by 1. The others are made all the
///            same, for they may hide these, but are not counted and have no surfels. Empty for all
/// throws     as `reconstruct`
TileSurface reconstruct_tile(const nn::Model& model, const scene::WindowedScene& part,
                             const Tiling& tiling, const Tile& tile, const Exposures& exposures,
                             const ReconstructOptions& options,
                             const std::function<Tensor(const Grid&)>& inside = {});

}  // namespace satsurf::reconstruct

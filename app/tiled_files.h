// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/app/tile_store.h"
#include "satsurf/rpc/area.h"
#include "satsurf/rpc/raster.h"
#include "satsurf/scene/raycast.h"

#include <filesystem>
#include <functional>
#include <optional>
#include <vector>

namespace satsurf::app {

/// What is left in memory of a surface that was put together of its tiles.
struct TiledSurface {
  scene::HeightField dsm;    ///< local z, means of square blocks of cells: at most 4096 a side
  Tensor confidence;         ///< alike
  rpc::HeightRange heights;  ///< lowest and highest cell, m above the ellipsoid; low > high: none
  double mean_confidence = 0;
};

/// A copy of a tiled surface that is small enough to be shown: means of square blocks of cells, at
/// most 2048 a side, all on one grid.
struct SurfaceOverview {
  scene::HeightField dsm;           ///< local z
  Tensor confidence, sigma, views;  ///< [H W]; sigma may be empty
  Tensor ortho;                     ///< [3 H W] in [0, 1], NaN where no image sees the cell
};
/// Reads it of the finished rasters.
/// made     what is left of the surface
/// step     cell of the rasters, m
/// throws   IoError
SurfaceOverview overview_of_files(const std::filesystem::path& folder, const TiledSurface& made,
                                  double step);

/// Writes dsm.tif, confidence.tif, height_sigma.tif, views.tif, ortho.tif and surfels.ply of finished
/// tiles, row of tiles by row of tiles.
/// records   of the tiles
/// scene     the images, for what the files say of them
/// colour    whether the orthophoto has three bands
/// datum     of the heights in dsm.tif
/// polygons  outside of which nothing is known; none for all
/// progress  told the share that is written; may throw to stop
/// throws    IoError
TiledSurface write_tiled_surface(const std::filesystem::path& folder,
                                 const reconstruct::Tiling& tiling,
                                 const std::vector<TileRecord>& records, const TileStore& store,
                                 const scene::Scene& scene, bool colour, rpc::HeightDatum datum,
                                 const std::optional<rpc::Area>& polygons,
                                 const std::function<void(double)>& progress);

}  // namespace satsurf::app

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/rpc/crs.h"
#include "satsurf/rpc/raster.h"

#include <filesystem>
#include <functional>

namespace satsurf::rpc {

/// A north-up grid of square cells in a system that need not be a zone of UTM.
struct ProjectedGrid {
  ProjectedCrs crs;
  double x0 = 0, y0 = 0, step = 1;  ///< upper-left corner and side of a cell, m of the system
  Index height = 0, width = 0;      ///< cells
};

/// The cells of a system that cover another grid. Its corner is a whole multiple of a cell, which is
/// as long in metres of the system.
/// grid           that is covered, in a zone of UTM
/// height, width  its cells
/// throws         Error where PROJ knows no way between the systems, or none for this ground
ProjectedGrid covering_grid(const GeoGrid& grid, Index height, Index width,
                            const ProjectedCrs& crs);

/// How a raster's values become those of other cells: between the four around, or the nearest one.
enum class Resampling { bilinear, nearest };

/// Makes a raster of `write_geo_raster` lie on another grid; tags, type, nodata and what heights are
/// above stay. Cells are known where the nearest one was, so that rasters of one grid that are known
/// alike stay so. The file changes as a whole or not at all.
/// progress  told the share that is done; may throw to stop
/// throws    IoError; Error where PROJ knows no way between the systems
void warp_raster(const std::filesystem::path& path, const ProjectedGrid& grid, Resampling how,
                 const std::function<void(double)>& progress = {});

}  // namespace satsurf::rpc

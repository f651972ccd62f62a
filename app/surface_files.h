// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/reconstruct/ortho.h"
#include "satsurf/reconstruct/reconstruct.h"
#include "satsurf/rpc/crs.h"
#include "satsurf/rpc/raster.h"
#include "satsurf/scene/scene.h"

#include <array>
#include <filesystem>
#include <functional>
#include <future>
#include <vector>

namespace satsurf::app {

/// What the rasters of a surface say of themselves.
struct SurfaceTags {
  rpc::GeoTags heights, confidence, sigma, views, ortho;
};
/// datum  of the heights
SurfaceTags surface_tags(const scene::Scene& scene, rpc::HeightDatum datum);
/// Values of an orthophoto as they can be stored: 0 is for cells that no image sees.
/// tags  of the file
void keep_off_nodata(Tensor& picture, const rpc::GeoTags& tags);

/// Writes dsm.tif, confidence.tif, views.tif and, where errors are expected, height_sigma.tif.
/// folder  to write into
/// datum   of the heights in dsm.tif
/// throws  IoError
void write_rasters(const std::filesystem::path& folder, const reconstruct::Reconstruction& made,
                   const scene::Scene& scene, const reconstruct::Visibility& visibility,
                   rpc::HeightDatum datum);

/// Writes the surfels, the largest file of all, `beside` what follows.
/// made          must outlive what is returned
/// most_surfels  that the file may hold, 0 for all
/// returns       ends when they are on the disk; `get` throws IoError
std::future<void> write_surfels(const std::filesystem::path& file,
                                const reconstruct::Reconstruction& made,
                                const rpc::LocalFrame& frame, Index most_surfels);

/// Writes ortho.tif. The images are read once more, for the values as they are stored.
/// image_dirs  where else to look for the images JSON files name
/// throws      IoError
void write_ortho(const std::filesystem::path& file, const reconstruct::Reconstruction& made,
                 const scene::Scene& scene, const reconstruct::Visibility& visibility,
                 const std::vector<std::filesystem::path>& image_dirs);

/// Brings all rasters of a surface into another system, onto one grid: heights, confidences, errors
/// and colours by what the four cells around say, counts by the nearest cell.
/// grid           that the rasters in the folder have
/// height, width  its cells
/// progress       told the share that is done; may throw to stop
/// returns        rows and columns of the new grid
/// throws         IoError; Error where PROJ knows no way into the system
std::array<Index, 2> bring_into(const rpc::ProjectedCrs& crs, const std::filesystem::path& folder,
                                const rpc::GeoGrid& grid, Index height, Index width,
                                const std::function<void(double)>& progress);

}  // namespace satsurf::app

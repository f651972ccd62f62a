// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/reconstruct/ortho.h"
#include "satsurf/reconstruct/reconstruct.h"
#include "satsurf/rpc/raster.h"
#include "satsurf/scene/scene.h"

#include <filesystem>
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

/// Writes dsm.tif, confidence.tif, views.tif and surfels.ply.
/// folder        to write into
/// most_surfels  that the file may hold, 0 for all; the surface itself is made of all
/// datum         of the heights in dsm.tif
/// throws        IoError
void write_surface(const std::filesystem::path& folder, const reconstruct::Reconstruction& made,
                   const scene::Scene& scene, const reconstruct::Visibility& visibility,
                   Index most_surfels, rpc::HeightDatum datum);

/// Writes ortho.tif. The images are read once more, for the values as they are stored.
/// image_dirs  where else to look for the images JSON files name
/// throws      IoError
void write_ortho(const std::filesystem::path& file, const reconstruct::Reconstruction& made,
                 const scene::Scene& scene, const reconstruct::Visibility& visibility,
                 const std::vector<std::filesystem::path>& image_dirs);

}  // namespace satsurf::app

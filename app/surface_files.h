// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/reconstruct/ortho.h"
#include "satsurf/reconstruct/reconstruct.h"
#include "satsurf/scene/scene.h"

#include <filesystem>
#include <vector>

namespace satsurf::app {

/// Writes dsm.tif, confidence.tif, views.tif and surfels.ply.
/// folder        to write into
/// most_surfels  that the file may hold, 0 for all; the surface itself is made of all
/// throws        IoError
void write_surface(const std::filesystem::path& folder, const reconstruct::Reconstruction& made,
                   const scene::Scene& scene, const reconstruct::Visibility& visibility,
                   Index most_surfels);

/// Writes ortho.tif. The images are read once more, for the values as they are stored.
/// image_dirs  where else to look for the images JSON files name
/// throws      IoError
void write_ortho(const std::filesystem::path& file, const reconstruct::Reconstruction& made,
                 const scene::Scene& scene, const reconstruct::Visibility& visibility,
                 const std::vector<std::filesystem::path>& image_dirs);

}  // namespace satsurf::app

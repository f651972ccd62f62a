// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "satsurf/splat/rasterize.h"

namespace satsurf::splat {

/// Writes surfels as a binary little-endian PLY with the property names of 3D Gaussian splatting viewers.
/// `comments` become header comment lines (the frame: CRS and origin with 17 digits). Written to a temporary
/// name and renamed. throws IoError
void write_ply(const std::filesystem::path& path, const Surfels& surfels, const std::vector<std::string>& comments,
               bool two_scales = false);

/// Surfels and the comment lines of a file `write_ply` or a 2DGS/3DGS program made. throws IoError
struct PlyContent {
  Surfels surfels;
  std::vector<std::string> comments;
};
PlyContent read_ply(const std::filesystem::path& path);

}  // namespace satsurf::splat

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/splat/rasterize.h"

#include <filesystem>
#include <string>
#include <vector>

namespace satsurf::splat {

/// Writes surfels as a binary little-endian PLY with the property names of 3D Gaussian splatting
/// viewers:
///   x y z         m
///   nx ny nz      unit normal, upwards whichever way rot turns the disc
///   f_dc_0..2     (colour - 0.5) / 0.28209479
///   opacity       logit
///   scale_0..2    natural logarithms of metres; scale_2 is log(1e-6)
///   rot_0..3      unit quaternion w x y z
/// Auxiliary channels are left out. A viewer that knows no discs draws them as very flat ellipsoids
/// and sorts those differently. Written to a temporary name and renamed.
/// surfels     [P ...]
/// comments    become header comment lines (the frame: CRS and origin with 17 digits)
/// two_scales  leaves out scale_2, as programs for discs expect
/// throws      IoError (also for numbers that are not finite), ShapeError
void write_ply(const std::filesystem::path& path, const Surfels& surfels,
               const std::vector<std::string>& comments, bool two_scales = false);

/// Puts files of `write_ply` one behind the other, without reading them into memory. Written to a
/// temporary name and renamed.
/// parts     files with all three scales; none makes a file without surfels
/// comments  of the result
/// returns   how many surfels each part holds
/// throws    IoError, also for a part of another layout or with a surfel that `read_ply` refuses
std::vector<Index> join_ply(const std::filesystem::path& path,
                            const std::vector<std::filesystem::path>& parts,
                            const std::vector<std::string>& comments);

/// Surfels, without gradients and auxiliary channels, and comment lines.
struct PlyContent {
  Surfels surfels;
  std::vector<std::string> comments;
};
/// Reads a file that `write_ply` or a program for discs or Gaussians made. The float properties of
/// its one vertex element may come in any order and there may be more of them; a third scale and
/// the normals are not used. Header, size and every number are checked.
/// throws  IoError in one line
PlyContent read_ply(const std::filesystem::path& path);

}  // namespace satsurf::splat

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/mesh/mesh.h"

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

namespace satsurf::mesh {

/// Writes a mesh as a binary little-endian PLY:
///   element vertex   float x y z nx ny nz, uchar red green blue
///   element face     list uchar int vertex_indices
/// Normals and colours are left out where the mesh has none. Written to a temporary name and
/// renamed.
/// comments  become header comment lines (the frame: CRS and origin with 17 digits)
/// poll      called now and then; what it throws ends the writing, without a file
/// throws    IoError (also for numbers that are not finite and faces of vertices there are not)
void write_ply(const std::filesystem::path& path, const Mesh& mesh,
               const std::vector<std::string>& comments, const std::function<void()>& poll = {});

/// A mesh and the comment lines of its file.
struct PlyContent {
  Mesh mesh;
  std::vector<std::string> comments;
};
/// Reads a binary little-endian mesh that `write_ply` or another program made: vertices with float
/// or double x y z, and normals and 8-bit colours if they are there, then faces as one list; further
/// numbers of a vertex are skipped, faces of more than three corners become fans. Header, size and
/// every number are checked. Coordinates have to lie within 1e5 m of the origin, where a float
/// still tells a centimetre: northings of UTM would snap to quarter or half metres.
/// throws  IoError in one line
PlyContent read_ply(const std::filesystem::path& path);

}  // namespace satsurf::mesh

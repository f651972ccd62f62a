// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <vector>

namespace satsurf::mesh {

/// Triangles in one local metric frame: x east, y north, z up, m.
struct Mesh {
  std::vector<std::array<float, 3>> vertices;  ///< m
  std::vector<std::array<float, 3>> normals;   ///< of the vertices, unit length, outwards; or empty
  std::vector<std::array<float, 3>> colours;   ///< of the vertices, in [0, 1]; or empty
  /// Vertex numbers, counter-clockwise seen from outside.
  std::vector<std::array<std::uint32_t, 3>> faces;
};

}  // namespace satsurf::mesh

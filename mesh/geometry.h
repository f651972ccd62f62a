// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/mesh/mesh.h"

#include <array>
#include <cmath>
#include <cstdint>

namespace satsurf::mesh {

/// A place or a direction in double: triangles of a kilometre's mesh are centimetres.
using Point = std::array<double, 3>;

inline Point wide(const std::array<float, 3>& p) {
  return {static_cast<double>(p[0]), static_cast<double>(p[1]), static_cast<double>(p[2])};
}
inline Point operator-(const Point& a, const Point& b) {
  return {a[0] - b[0], a[1] - b[1], a[2] - b[2]};
}
inline double dot(const Point& a, const Point& b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}
inline Point cross(const Point& a, const Point& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
inline double length(const Point& p) { return std::sqrt(dot(p, p)); }

inline std::array<Point, 3> corners(const Mesh& mesh, const std::array<std::uint32_t, 3>& face) {
  return {wide(mesh.vertices[face[0]]), wide(mesh.vertices[face[1]]), wide(mesh.vertices[face[2]])};
}
/// Of a face by its number.
inline std::array<Point, 3> corners(const Mesh& mesh, std::uint32_t face) {
  return corners(mesh, mesh.faces[face]);
}
/// Twice the area of a triangle, along its normal.
inline Point doubled_area(const std::array<Point, 3>& c) { return cross(c[1] - c[0], c[2] - c[0]); }

/// Sets the normals of the vertices: the mean of their faces', weighted by area; upwards where there is none.
void find_normals(Mesh& mesh);

}  // namespace satsurf::mesh

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/mesh/geometry.h"

#include <cstddef>
#include <vector>

namespace satsurf::mesh {

void find_normals(Mesh& mesh) {
  std::vector<Point> sum(mesh.vertices.size(), Point{0, 0, 0});
  for (const auto& face : mesh.faces) {
    const Point n = doubled_area(corners(mesh, face));
    for (const std::uint32_t v : face)
      for (std::size_t a = 0; a < 3; ++a) sum[v][a] += n[a];
  }
  mesh.normals.resize(sum.size());
  for (std::size_t v = 0; v < sum.size(); ++v) {
    const double l = length(sum[v]);
    for (std::size_t a = 0; a < 3; ++a)
      mesh.normals[v][a] = l > 0 ? static_cast<float>(sum[v][a] / l) : (a == 2 ? 1.f : 0.f);
  }
}

}  // namespace satsurf::mesh

// SPDX-License-Identifier: Apache-2.0
// Meshes: every face of what is read names vertices there are, and it can be written and read again.
#include "satsurf/mesh/ply.h"

#include "tests/fuzz/fuzz.h"

namespace satsurf::fuzz {

void run(std::string_view bytes) {
  const auto path = folder().put("a.ply", bytes);
  only<IoError>([&] {
    const mesh::PlyContent content = mesh::read_ply(path);
    for (const auto& face : content.mesh.faces)
      for (const std::uint32_t v : face)
        require(v < content.mesh.vertices.size(), "faces name vertices there are");
    const auto again = folder().path() / "b.ply";
    mesh::write_ply(again, content.mesh, {});
    require(mesh::read_ply(again).mesh.faces == content.mesh.faces, "the faces that were written");
  });
}

}  // namespace satsurf::fuzz

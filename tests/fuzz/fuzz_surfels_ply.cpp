// SPDX-License-Identifier: Apache-2.0
// Surfels: what is read can be written, and read again.
#include "satsurf/splat/ply.h"

#include "tests/fuzz/fuzz.h"

namespace satsurf::fuzz {

void run(std::string_view bytes) {
  const auto path = folder().put("a.ply", bytes), joined = folder().path() / "joined.ply";
  splat::PlyContent content;
  if (only<IoError>([&] { content = splat::read_ply(path); }))
    only<IoError>([&] {
      const auto again = folder().path() / "b.ply";
      splat::write_ply(again, content.surfels, {});
      require(splat::read_ply(again).surfels.means.value().count() ==
                  content.surfels.means.value().count(),
              "as many surfels as were written");
    });
  only<IoError>([&] { splat::join_ply(joined, {path, path}, {}); });
}

}  // namespace satsurf::fuzz

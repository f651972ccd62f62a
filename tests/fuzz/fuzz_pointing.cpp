// SPDX-License-Identifier: Apache-2.0
// Files of pointing: the shifts read are those of cameras, and can be applied.
#include "satsurf/scene/pointing_file.h"

#include <cmath>

#include "tests/fuzz/fuzz.h"

namespace satsurf::fuzz {

void run(std::string_view bytes) {
  const auto path = folder().put("pointing.json", bytes);
  only<IoError>([&] {
    for (const auto& [name, shift] : scene::read_pointing(path))
      require(std::isfinite(shift.x) && std::isfinite(shift.y), "shifts are finite");
  });
}

}  // namespace satsurf::fuzz

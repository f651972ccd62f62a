// SPDX-License-Identifier: Apache-2.0
// Files of pointing: the shifts read are those of cameras, and can be applied.
#include "satsurf/scene/pointing_file.h"

#include <cmath>

#include "tests/fuzz/fuzz.h"

namespace satsurf::fuzz {

void run(std::string_view bytes) {
  const auto path = folder().put("pointing.json", bytes);
  only<IoError>([&] {
    for (const auto& [name, known] : scene::read_pointing(path)) {
      require(std::isfinite(known.shift.x) && std::isfinite(known.shift.y), "shifts are finite");
      require(std::isfinite(known.slope.at.x) && std::isfinite(known.slope.at.y),
              "places are finite");
      for (const auto& row : known.slope.per_pixel)
        for (const double px : row) require(std::isfinite(px), "slopes are finite");
    }
  });
}

}  // namespace satsurf::fuzz

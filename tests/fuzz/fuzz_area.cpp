// SPDX-License-Identifier: Apache-2.0
// Polygons around the ground wanted, in any form of vector file that is read by its content.
#include "satsurf/rpc/area.h"

#include <cmath>

#include "tests/fuzz/fuzz.h"

namespace satsurf::fuzz {

void run(std::string_view bytes) {
  const auto path = folder().put("area.geojson", bytes);
  only<IoError>([&] {
    const rpc::Area area = rpc::read_area(path, {33, true});
    for (const double side : area.bounds()) require(std::isfinite(side), "corners are finite");
    area.contains(area.bounds()[0], area.bounds()[1]);
  });
}

}  // namespace satsurf::fuzz

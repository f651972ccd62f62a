// SPDX-License-Identifier: Apache-2.0
// The four numbers that place a surface of DFC2019.
#include "satsurf/rpc/raster.h"

#include <cmath>

#include "tests/fuzz/fuzz.h"
#include "tests/fuzz/small_raster.h"

namespace satsurf::fuzz {

void run(std::string_view bytes) {
  static const auto surface = small_raster("S_DSM.tif");
  folder().put("S_DSM.txt", bytes);
  only<IoError>([&] {
    const rpc::GeoGrid grid = rpc::read_geo_raster(surface, rpc::UtmZone{33, true}).grid;
    require(std::isfinite(grid.x0) && std::isfinite(grid.y0) && grid.step > 0,
            "a grid has a place");
  });
}

}  // namespace satsurf::fuzz

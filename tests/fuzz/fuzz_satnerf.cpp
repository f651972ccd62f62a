// SPDX-License-Identifier: Apache-2.0
// The JSON file of a view, as Sat-NeRF and EOGS read it, beside the image it names or not.
#include "satsurf/rpc/read.h"

#include <cmath>

#include "tests/fuzz/fuzz.h"
#include "tests/fuzz/small_raster.h"

namespace satsurf::fuzz {

void run(std::string_view bytes) {
  static const auto image = small_raster("a.tif");
  const auto path = folder().put("a.json", bytes);
  only<IoError>([&] {
    const rpc::SatNerfJson json = rpc::read_satnerf_json(path);
    require(json.width > 0 && json.height > 0, "an image has pixels");
    require(std::isfinite(json.min_alt) && json.min_alt < json.max_alt, "heights are a range");
  });
  only<IoError>([&] { rpc::open_view(path); });
  only<IoError>([&] { rpc::read_rpc_file(path); });
}

}  // namespace satsurf::fuzz

// SPDX-License-Identifier: Apache-2.0
// Camera files in every dialect; which one it is, is told by the content.
#include "satsurf/rpc/read.h"

#include <algorithm>
#include <cmath>

#include "tests/fuzz/fuzz.h"

namespace satsurf::fuzz {

void run(std::string_view bytes) {
  const auto path = folder().put("camera", bytes);
  rpc::Rpc camera;
  if (!only<IoError>([&] { camera = rpc::read_rpc_file(path); })) return;
  const auto finite = [](const auto& list) {
    return std::ranges::all_of(list, [](double v) { return std::isfinite(v); });
  };
  require(finite(camera.line_num) && finite(camera.line_den) && finite(camera.samp_num) &&
              finite(camera.samp_den),
          "coefficients are finite");
  require(finite(std::array{camera.line_off, camera.samp_off, camera.lat_off, camera.lon_off,
                            camera.height_off}),
          "offsets are finite");
  for (const double scale : {camera.line_scale, camera.samp_scale, camera.lat_scale,
                             camera.lon_scale, camera.height_scale})
    require(std::isfinite(scale) && scale != 0, "scales divide");
}

}  // namespace satsurf::fuzz

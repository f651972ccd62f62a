// SPDX-License-Identifier: Apache-2.0
// Rasters with their tags, as images and as surfaces. GDAL decides by the content what a file is; it is not instrumented.
#include "satsurf/rpc/raster.h"
#include "satsurf/rpc/read.h"

#include "tests/fuzz/fuzz.h"

namespace satsurf::fuzz {

void run(std::string_view bytes) {
  const auto path = folder().put("a.tif", bytes);
  rpc::RasterInfo info;
  if (only<IoError>([&] { info = rpc::read_info(path); })) {
    require(info.width > 0 && info.height > 0 && info.bands > 0, "a raster has pixels");
    // Up to 16 MiB are read whatever the file's size, which takes longer than an input may.
    if (static_cast<double>(info.width) * static_cast<double>(info.height * info.bands) > 1e6)
      return;
    only<IoError>([&] {
      const rpc::Image image = rpc::read_image(path);
      only<ShapeError>([&] { rpc::to_rgb(image); });
    });
    only<IoError>([&] { rpc::open_view(path); });
    only<IoError>([&] { rpc::open_reduced(rpc::find_view(path), 2); });
    only<IoError>([&] { rpc::open_window(rpc::find_view(path), {1, 2, 3, 2}); });
  }
  only<IoError>([&] { rpc::read_geo_raster(path); });
}

}  // namespace satsurf::fuzz

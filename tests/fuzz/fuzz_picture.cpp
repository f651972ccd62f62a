// SPDX-License-Identifier: Apache-2.0
// Pictures that are compared: PNG, JPEG and TIFF, as GDAL reads them.
#include "satsurf/rpc/picture.h"

#include "tests/fuzz/fuzz.h"

namespace satsurf::fuzz {

void run(std::string_view bytes) {
  const auto path = folder().put("picture.png", bytes);
  only<IoError, Error>([&] {
    const Tensor picture = rpc::read_picture(path);
    require(picture.rank() == 3 && (picture.dim(0) == 1 || picture.dim(0) == 3),
            "grey or three colours");
    require(picture.count() > 0, "some pixels");
  });
}

}  // namespace satsurf::fuzz

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/tensor.h"

#include <filesystem>

namespace satsurf::app {

/// Reads a picture: PNG, JPEG, TIFF, whatever its name. 8-bit values are divided by 255 and 16-bit ones by 65535,
/// floating-point ones come as they are; transparency is left out.
/// returns  [3 H W] or, for grey, [1 H W]
/// throws   IoError naming the file; Error for more than the memory holds
Tensor read_picture(const std::filesystem::path& path);

}  // namespace satsurf::app

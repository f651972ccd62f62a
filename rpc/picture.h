// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/tensor.h"

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

namespace satsurf::rpc {

/// Reads a picture: PNG, JPEG, TIFF, whatever its name. 8-bit values are divided by 255, 16-bit ones by 65535 and those
/// of fewer bits by their largest, floating-point ones come as they are; transparency is left out, and an index becomes
/// the colour it stands for.
/// returns  [3 H W] or, for grey, [1 H W]
/// throws   IoError naming the file; Error for more than the memory holds
Tensor read_picture(const std::filesystem::path& path);

enum class PictureFormat { png, jpeg };

/// The bytes of a picture's file.
/// where   begins the error text
/// pixels  [height width channels] 1 channel or 3
/// throws  IoError
std::string encoded_picture(const std::string& where, std::vector<std::uint8_t>& pixels,
                            Index height, Index width, Index channels, PictureFormat format);

}  // namespace satsurf::rpc

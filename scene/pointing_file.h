// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/scene/pointing.h"

#include <filesystem>

namespace satsurf::scene {

/// Writes how the cameras of a scene agree and the shifts, as docs/pointing.md describes.
/// throws  IoError
void write_pointing(const std::filesystem::path& path, const Pointing& pointing);

/// The shifts in such a file. Only `images` is read, so that one can be written by hand.
/// throws  IoError naming the file and what is missing or malformed
NamedShifts read_pointing(const std::filesystem::path& path);

}  // namespace satsurf::scene

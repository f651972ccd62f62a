// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <string>
#include <string_view>

namespace satsurf::app {

/// The SHA-256 of the bytes as 64 lower-case hexadecimal digits, as `sha256sum` prints it.
/// Source: FIPS 180-4.
std::string sha256(std::string_view bytes);
/// The same of a file's content, read in pieces.
/// throws  IoError
std::string sha256_of_file(const std::filesystem::path& path);

}  // namespace satsurf::app

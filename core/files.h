// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

namespace satsurf {

// What the standard library answers with exceptions of its own (a name too long for the system, a
// folder that may not be entered) is "no" here: a reader then complains in its own words.

/// Whether anything lies under this name.
bool path_exists(const std::filesystem::path& path) noexcept;
/// Whether it is a regular file, or a link to one.
bool is_file(const std::filesystem::path& path) noexcept;
/// Whether it is a folder, or a link to one.
bool is_folder(const std::filesystem::path& path) noexcept;

/// What lies in a folder, sorted.
/// wanted  what the folder should be, for the error text
/// throws  IoError for one that is missing or may not be listed
std::vector<std::filesystem::path> entries_of(const std::filesystem::path& folder,
                                              const std::string& wanted);

/// Refuses what cannot be read to its end as often as one likes: a pipe would wait for a writer, a
/// device may never end.
/// path    of the file
/// wanted  what it should be, for the error text: "a raster"
/// throws  IoError `path: no such file, expected WANTED`, or what it is instead of a file
void require_file(const std::filesystem::path& path, const std::string& wanted);

/// What lies beside a file, for libraries that look for companions of it (cameras, masks, overviews)
/// and would wait for a pipe's writer: the names of files and folders. Nothing for a folder that may
/// not be listed.
/// throws  IoError for a pipe, socket or device named as the file is but for what follows its stem
std::vector<std::string> names_beside(const std::filesystem::path& path);

constexpr std::uintmax_t kMostText = 64u
                                     << 20;  ///< bytes; cameras with key points have some 100 kB

/// The bytes of a file of text.
/// wanted  what it should be, for the error text
/// throws  IoError as `require_file`, and for a file of more than `kMostText` bytes
std::string read_text_file(const std::filesystem::path& path, const std::string& wanted);

}  // namespace satsurf

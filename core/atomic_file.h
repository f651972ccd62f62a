// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <functional>
#include <span>
#include <string_view>
#include <vector>

namespace satsurf {

/// Writes the pieces one after the other to a temporary name in the same folder, flushes them to
/// the disk and renames: the old file or the new one, never half of one. Creates missing folders.
/// path    of the file
/// pieces  its bytes, in order
/// throws  IoError that names the file and the system's reason; no temporary file is left
void atomic_write(const std::filesystem::path& path, std::span<const std::string_view> pieces);
/// The same for pieces that are made one after the other.
/// next    returns the next piece, which must live until the next call; an empty one is the end.
///         What it throws is passed on, without a file
void atomic_write(const std::filesystem::path& path, const std::function<std::string_view()>& next);
/// The same for one piece.
inline void atomic_write(const std::filesystem::path& path, std::string_view bytes) {
  atomic_write(path, std::span(&bytes, 1));
}

/// Puts a finished file in the place of another of the same file system, as `atomic_write` does.
/// throws  IoError that names the place and the system's reason; the finished file then stays
void put_in_place(const std::filesystem::path& made, const std::filesystem::path& path);

/// Removes the temporary files of writers that were killed on the way; those of others are locked.
/// folder   where they wrote
/// file     name of the one file whose temporary files are meant; empty for all
/// returns  what was removed
std::vector<std::filesystem::path> remove_partial_files(const std::filesystem::path& folder,
                                                        const std::filesystem::path& file = {});

}  // namespace satsurf

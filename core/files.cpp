// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/files.h"

#include "satsurf/core/error.h"

#include <algorithm>
#include <cctype>
#include <fstream>
#include <system_error>

namespace satsurf {
namespace {

namespace fs = std::filesystem;

/// What a name stands for that is no file, in words.
const char* kind_text(fs::file_type type) {
  switch (type) {
    case fs::file_type::directory:
      return "a folder";
    case fs::file_type::fifo:
      return "a pipe";
    case fs::file_type::socket:
      return "a socket";
    case fs::file_type::block:
    case fs::file_type::character:
      return "a device";
    default:
      return "no regular file";
  }
}

}  // namespace

bool path_exists(const fs::path& path) noexcept {
  std::error_code ignored;
  return fs::exists(path, ignored);
}

bool is_file(const fs::path& path) noexcept {
  std::error_code ignored;
  return fs::is_regular_file(path, ignored);
}

bool is_folder(const fs::path& path) noexcept {
  std::error_code ignored;
  return fs::is_directory(path, ignored);
}

std::vector<fs::path> entries_of(const fs::path& folder, const std::string& wanted) {
  std::error_code error;
  std::vector<fs::path> entries;
  for (fs::directory_iterator at(folder, error), end; !error && at != end; at.increment(error))
    entries.push_back(at->path());
  if (error)
    throw IoError(folder.string() + ": cannot be listed (" + error.message() + "), expected " +
                  wanted);
  std::sort(entries.begin(), entries.end());
  return entries;
}

void require_file(const fs::path& path, const std::string& wanted) {
  std::error_code error;
  const fs::file_type type = fs::status(path, error).type();
  if (type == fs::file_type::regular) return;
  if (type == fs::file_type::not_found)
    throw IoError(path.string() + ": no such file, expected " + wanted);
  if (error)
    throw IoError(path.string() + ": cannot be found (" + error.message() + "), expected " +
                  wanted);
  throw IoError(path.string() + ": is " + kind_text(type) + ", expected " + wanted);
}

std::vector<std::string> names_beside(const fs::path& path) {
  const std::string stem = path.stem().string();
  const auto is_companion = [&](const std::string& name) {  // IMAGE.tif.ovr, image_rpc.txt
    const auto alike = [](unsigned char a, unsigned char b) {
      return std::tolower(a) == std::tolower(b);
    };
    return name.size() > stem.size() && std::equal(stem.begin(), stem.end(), name.begin(), alike) &&
           std::isalnum(static_cast<unsigned char>(name[stem.size()])) == 0;
  };
  std::vector<std::string> names;
  const fs::path folder = path.has_parent_path() ? path.parent_path() : fs::path(".");
  std::error_code error;
  for (fs::directory_iterator at(folder, error), end; !error && at != end; at.increment(error)) {
    std::error_code unknown;
    const fs::file_type type = at->status(unknown).type();
    const std::string name = at->path().filename().string();
    if (type == fs::file_type::regular || type == fs::file_type::directory)
      names.push_back(name);
    else if (type != fs::file_type::not_found && !unknown && is_companion(name))
      throw IoError((path.parent_path() / name).string() + ": is " + kind_text(type) +
                    ", expected a file or nothing under this name beside " + path.string());
  }
  std::sort(names.begin(), names.end());
  return names;
}

std::string read_text_file(const fs::path& path, const std::string& wanted) {
  require_file(path, wanted);
  std::ifstream in(path, std::ios::binary);
  if (!in.is_open()) throw IoError(path.string() + ": cannot be read, expected " + wanted);
  // The size is what arrives: files of /proc say 0.
  std::string text;
  constexpr std::size_t kFirst = 16u << 10, kPiece = 1u << 20;
  while (in) {
    const std::size_t before = text.size(), piece = before == 0 ? kFirst : kPiece;
    text.resize(before + piece);
    in.read(text.data() + before, static_cast<std::streamsize>(piece));
    text.resize(before + static_cast<std::size_t>(in.gcount()));
    if (text.size() > kMostText)
      throw IoError(path.string() + ": larger than " + std::to_string(kMostText >> 20) +
                    " MiB, expected " + wanted);
  }
  if (in.bad()) throw IoError(path.string() + ": cannot be read, expected " + wanted);
  return text;
}

}  // namespace satsurf

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/atomic_file.h"

#include "satsurf/core/error.h"

#include <atomic>
#include <cerrno>
#include <string>
#include <system_error>

#include <fcntl.h>
#include <unistd.h>

namespace satsurf {
namespace {

[[noreturn]] void fail(const std::filesystem::path& path, const char* what, int code) {
  throw IoError(path.string() + ": cannot " + what + " (" + std::generic_category().message(code) +
                "), expected a place that can be written");
}

/// Makes the names in `folder` durable. Some file systems cannot; the content is then safe all the
/// same.
void flush_folder(const std::filesystem::path& folder) {
  const int fd = ::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (fd < 0) return;
  ::fsync(fd);
  ::close(fd);
}

}  // namespace

void atomic_write(const std::filesystem::path& path, std::span<const std::string_view> pieces) {
  static std::atomic<unsigned> number{0};  // two threads may write the same file
  const std::filesystem::path folder = path.has_parent_path() ? path.parent_path() : ".";
  std::error_code ec;
  std::filesystem::create_directories(folder, ec);
  if (ec) fail(path, "make its folder", ec.value());

  const std::filesystem::path temporary =
      folder / ('.' + path.filename().string() + ".partial-" + std::to_string(::getpid()) + '-' +
                std::to_string(number++));
  const int fd = ::open(temporary.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
  if (fd < 0) fail(path, "be created", errno);
  int code = 0;
  for (std::string_view piece : pieces) {
    while (!piece.empty() && code == 0) {
      const ssize_t n = ::write(fd, piece.data(), piece.size());
      if (n >= 0)
        piece.remove_prefix(n);
      else if (errno != EINTR)
        code = errno;
    }
  }
  if (code == 0 && ::fsync(fd) != 0) code = errno;
  if (::close(fd) != 0 && code == 0) code = errno;
  if (code == 0 && ::rename(temporary.c_str(), path.c_str()) != 0) code = errno;
  if (code != 0) {
    ::unlink(temporary.c_str());
    fail(path, "be written", code);
  }
  flush_folder(folder);
}

}  // namespace satsurf

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/atomic_file.h"

#include "satsurf/core/error.h"

#include <atomic>
#include <cerrno>
#include <string>
#include <string_view>
#include <system_error>

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

namespace satsurf {
namespace {

[[noreturn]] void fail(const std::filesystem::path& path, const char* what, int code) {
  throw IoError(path.string() + ": cannot " + what + " (" + std::generic_category().message(code) +
                "), expected a place that can be written");
}

std::filesystem::path folder_of(const std::filesystem::path& path) {
  return path.has_parent_path() ? path.parent_path() : ".";
}

/// Makes the names in `folder` durable. Some file systems cannot; the content is then safe all the
/// same.
void flush_folder(const std::filesystem::path& folder) {
  const int fd = ::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (fd < 0) return;
  ::fsync(fd);
  ::close(fd);
}

/// Puts a finished file, open as `fd`, in the place of another: both its bytes and its name on the
/// disk.
/// returns  0, or the error's number
int flush_and_rename(int fd, const std::filesystem::path& made, const std::filesystem::path& path) {
  if (::fsync(fd) != 0 || ::rename(made.c_str(), path.c_str()) != 0) return errno;
  flush_folder(folder_of(path));
  return 0;
}

constexpr std::string_view kPartial = ".partial-";

/// Whether `name` is one that `atomic_write` makes: a dot, the file's name, the mark, two numbers.
bool is_partial(const std::string& name, const std::string& file) {
  const std::size_t mark = name.rfind(kPartial);
  if (!name.starts_with('.') || mark == std::string::npos || mark < 2) return false;
  const std::string_view numbers = std::string_view(name).substr(mark + kPartial.size());
  const std::size_t dash = numbers.find('-');
  const auto digits = [](std::string_view s) {
    return !s.empty() && s.find_first_not_of("0123456789") == std::string_view::npos;
  };
  return (file.empty() || name.compare(1, mark - 1, file) == 0) && dash != std::string_view::npos &&
         digits(numbers.substr(0, dash)) && digits(numbers.substr(dash + 1));
}

}  // namespace

namespace {

/// Writes all of some bytes.
/// returns  0, or the error's number
int write_all(int fd, std::string_view bytes) {
  while (!bytes.empty()) {
    const ssize_t n = ::write(fd, bytes.data(), bytes.size());
    if (n >= 0)
      bytes.remove_prefix(static_cast<std::size_t>(n));
    else if (errno != EINTR)
      return errno;
  }
  return 0;
}

/// Writes pieces one after the other, small ones together: weights have hundreds of tensors.
/// returns  0, or the error's number
int write_pieces(int fd, const std::function<std::string_view()>& next) {
  constexpr std::size_t kTogether = std::size_t{1} << 20;  // bytes
  // What waits for the disk: gigabytes would keep whoever wants to stop waiting as well.
  constexpr std::size_t kMostUnflushed = std::size_t{64} << 20;
  std::string small;
  std::size_t unflushed = 0;
  for (std::string_view piece = next(); !piece.empty(); piece = next()) {
    if (small.size() + piece.size() > kTogether) {
      if (const int code = write_all(fd, small)) return code;
      small.clear();
    }
    if (piece.size() < kTogether)
      small += piece;
    else if (const int code = write_all(fd, piece))
      return code;
    unflushed += piece.size();
    if (unflushed < kMostUnflushed) continue;
    if (::fdatasync(fd) != 0) return errno;
    unflushed = 0;
  }
  return write_all(fd, small);
}

}  // namespace

void atomic_write(const std::filesystem::path& path, std::span<const std::string_view> pieces) {
  std::size_t at = 0;
  atomic_write(path, [&]() -> std::string_view {
    while (at < pieces.size() && pieces[at].empty()) ++at;
    return at < pieces.size() ? pieces[at++] : std::string_view();
  });
}

void atomic_write(const std::filesystem::path& path,
                  const std::function<std::string_view()>& next) {
  static std::atomic<unsigned> number{0};  // two threads may write the same file
  const std::filesystem::path folder = folder_of(path);
  std::error_code ec;
  std::filesystem::create_directories(folder, ec);
  if (ec) fail(path, "make its folder", ec.value());

  const std::filesystem::path temporary =
      folder / ('.' + path.filename().string() + std::string(kPartial) +
                std::to_string(::getpid()) + '-' + std::to_string(number++));
  const int fd = ::open(temporary.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
  if (fd < 0) fail(path, "be created", errno);
  ::flock(fd, LOCK_EX | LOCK_NB);  // tells `remove_partial_files` that its writer lives
  int code = 0;
  try {
    code = write_pieces(fd, next);
  } catch (...) {
    ::close(fd);
    ::unlink(temporary.c_str());
    throw;
  }
  if (code == 0) code = flush_and_rename(fd, temporary, path);
  // The lock ends with it, when the name is no longer one of a temporary file.
  if (::close(fd) != 0 && code == 0) code = errno;
  if (code != 0) {
    ::unlink(temporary.c_str());
    fail(path, "be written", code);
  }
}

void put_in_place(const std::filesystem::path& made, const std::filesystem::path& path) {
  const int fd = ::open(made.c_str(), O_RDONLY | O_CLOEXEC);
  if (fd < 0) fail(path, "be put in its place", errno);
  const int code = flush_and_rename(fd, made, path);
  ::close(fd);
  if (code != 0) fail(path, "be put in its place", code);
}

std::vector<std::filesystem::path> remove_partial_files(const std::filesystem::path& folder,
                                                        const std::filesystem::path& file) {
  std::vector<std::filesystem::path> removed;
  std::error_code ignored;
  for (const auto& entry : std::filesystem::directory_iterator(
           folder.empty() ? std::filesystem::path(".") : folder, ignored)) {
    if (!is_partial(entry.path().filename().string(), file.string()) ||
        !std::filesystem::is_regular_file(entry.symlink_status(ignored)))
      continue;
    const int fd = ::open(entry.path().c_str(), O_RDONLY | O_NOFOLLOW | O_CLOEXEC);
    if (fd < 0) continue;
    if (::flock(fd, LOCK_EX | LOCK_NB) == 0 && ::unlink(entry.path().c_str()) == 0)
      removed.push_back(entry.path());
    ::close(fd);
  }
  return removed;
}

}  // namespace satsurf

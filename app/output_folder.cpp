// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/output_folder.h"

#include "satsurf/app/log.h"
#include "satsurf/app/record.h"
#include "satsurf/core/atomic_file.h"
#include "satsurf/core/error.h"

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <string_view>
#include <system_error>
#include <utility>

#include <fcntl.h>
#include <unistd.h>

namespace satsurf::app {
namespace {

namespace fs = std::filesystem;

constexpr std::string_view kPartial = ".partial-";    // on its way to the place
constexpr std::string_view kReplaced = ".replaced-";  // on its way out of it

/// Runs a file system operation and turns its failure into our words.
template <class F>
auto attempt(const fs::path& folder, const char* what, const F& operation) {
  try {
    return operation();
  } catch (const fs::filesystem_error& e) {
    throw IoError("--out: " + folder.string() + " cannot be " + what + " (" + e.code().message() +
                  ")");
  }
}

/// Whether `folder` is `inner` or one of the folders around it.
bool holds(const fs::path& folder, const fs::path& inner) {
  return std::mismatch(folder.begin(), folder.end(), inner.begin(), inner.end()).first ==
         folder.end();
}

/// The absolute name, links resolved, so that renaming replaces what a link points to and not the
/// link.
fs::path resolved(const fs::path& folder) {
  if (folder.empty()) throw IoError("--out: the name is empty, expected a folder");
  fs::path path =
      attempt(folder, "found", [&] { return fs::weakly_canonical(fs::absolute(folder)); });
  return path.has_filename() ? path : path.parent_path();  // "out/" is "out"
}

/// Whether a file or folder lies in `folder`, or a link to it does.
bool lies_in(const fs::path& folder, const fs::path& input) {
  std::error_code unknown;  // what cannot be resolved cannot be read either, which its reader says
  const fs::path name = fs::absolute(input, unknown).lexically_normal();
  const fs::path real = fs::weakly_canonical(name, unknown),
                 place = fs::weakly_canonical(name.parent_path(), unknown);
  return (!real.empty() && holds(folder, real)) ||
         (!place.empty() && holds(folder, place / name.filename()));
}

[[noreturn]] void refuse_busy(const fs::path& named, const fs::path& folder) {
  throw IoError("--out: " + named.string() + " is being worked on by another process (" +
                folder.string() + "), expected to have it alone");
}

void check(const fs::path& named, const fs::path& target, bool overwrite,
           const std::vector<fs::path>& inputs) {
  attempt(named, "read", [&] {
    if (!fs::exists(target)) return;
    if (!fs::is_directory(target))
      throw IoError("--out: " + named.string() + " is a file, expected a folder");
    for (const fs::path& input : inputs)
      if (!input.empty() && lies_in(target, input))
        throw IoError("--out: " + named.string() + " holds the input " + input.string() +
                      ", expected a folder of its own");
    if (fs::is_empty(target)) return;
    if (!overwrite)
      throw IoError("--out: " + named.string() + " exists and is not empty; use --overwrite");
    const char* home = std::getenv("HOME");
    if (holds(target, fs::current_path()) ||
        (home != nullptr && *home != '\0' && holds(target, fs::weakly_canonical(home))))
      throw IoError("--out: " + named.string() +
                    " holds the working or the home folder, which --overwrite would remove");
    if (!holds_run(target))
      throw IoError("--out: " + named.string() +
                    " holds no run.json of an earlier run, expected one for --overwrite; name "
                    "another folder");
    if (FolderLock(target).busy()) refuse_busy(named, target);
  });
}

/// The outermost folder that has to be made for `folder`; empty if it exists.
fs::path outermost_missing(fs::path folder) {
  fs::path missing;
  for (; !folder.empty() && !fs::exists(folder); folder = folder.parent_path()) missing = folder;
  return missing;
}

fs::path sibling(const fs::path& target, std::string_view kind) {
  fs::path name = target;
  name += std::string(kind) + std::to_string(::getpid());
  return name;
}

/// The folders beside `target` that `sibling` has named for any process.
std::vector<fs::path> siblings(const fs::path& target, std::string_view kind) {
  const std::string start = target.filename().string() + std::string(kind);
  std::vector<fs::path> found;
  std::error_code ignored;
  for (const auto& entry : fs::directory_iterator(target.parent_path(), ignored)) {
    const std::string name = entry.path().filename().string();
    if (name.size() > start.size() && name.starts_with(start) &&
        name.find_first_not_of("0123456789", start.size()) == std::string::npos &&
        fs::is_directory(entry.symlink_status(ignored)))
      found.push_back(entry.path());
  }
  std::sort(found.begin(), found.end());
  return found;
}

/// Refuses a place that a living process is about to put something in, and puts back what a killed
/// one had moved out of it.
/// throws  IoError
void look_around(const fs::path& named, const fs::path& target) {
  for (const fs::path& other : siblings(target, kPartial))
    if (FolderLock(other).busy()) refuse_busy(named, other);
  std::error_code failed;
  for (const fs::path& left : siblings(target, kReplaced)) {
    if (fs::exists(target) || !FolderLock(left).ours()) continue;
    fs::rename(left, target, failed);
    if (!failed)
      log_line(LogLevel::info,
               target.string() + " put back, which a stopped run had moved to " + left.string());
  }
}

/// Removes what killed processes have left in and beside `target`.
void clear_leftovers(const fs::path& target) {
  const auto tell = [](const fs::path& left) {
    log_line(LogLevel::info, left.string() + " removed, left by a stopped run");
  };
  for (const std::string_view kind : {kReplaced, kPartial})
    for (const fs::path& left : siblings(target, kind)) {
      if (!FolderLock(left).ours()) continue;
      std::error_code failed;
      fs::remove_all(left, failed);
      if (!failed) tell(left);
    }
  for (const fs::path& left : remove_partial_files(target)) tell(left);
}

/// A new folder of that name, locked. Whoever clears left-overs may take it away between its making
/// and its locking.
FolderLock made_and_locked(const fs::path& folder) {
  FolderLock lock;
  for (int attempt = 0; attempt < 3; ++attempt) {
    fs::create_directories(folder);
    lock = FolderLock(folder);
    if (fs::exists(folder)) break;
  }
  return lock;
}

/// Two folders take each other's names in one step.
bool exchanged(const fs::path& a, const fs::path& b) {
  return ::renameat2(AT_FDCWD, a.c_str(), AT_FDCWD, b.c_str(), RENAME_EXCHANGE) == 0;
}

}  // namespace

OutputFolder::OutputFolder(fs::path named, fs::path target, fs::path work)
    : named_(std::move(named)),
      target_(std::move(target)),
      work_(std::move(work)),
      pending_(work_ != target_) {}

OutputFolder::OutputFolder(OutputFolder&& other) noexcept
    : named_(std::move(other.named_)),
      target_(std::move(other.target_)),
      work_(std::move(other.work_)),
      first_made_(std::move(other.first_made_)),
      inputs_(std::move(other.inputs_)),
      lock_(std::move(other.lock_)),
      overwrite_(other.overwrite_),
      cleared_(other.cleared_),
      pending_(std::exchange(other.pending_, false)) {}

OutputFolder::~OutputFolder() {
  if (!pending_) return;
  std::error_code ignored;
  fs::remove_all(work_, ignored);
  if (first_made_.empty()) return;
  // of the folders made around it, those that nobody else has put anything into
  for (fs::path around = work_.parent_path(); holds(first_made_, around);
       around = around.parent_path())
    if (!fs::remove(around, ignored)) break;
}

OutputFolder OutputFolder::staged(const fs::path& folder, bool overwrite,
                                  std::vector<fs::path> inputs) {
  const fs::path target = resolved(folder);
  look_around(folder, target);
  check(folder, target, overwrite, inputs);
  OutputFolder out(folder, target, sibling(target, kPartial));
  out.inputs_ = std::move(inputs);
  out.overwrite_ = overwrite;
  attempt(folder, "made", [&] {
    out.first_made_ = outermost_missing(out.work_);
    out.lock_ = made_and_locked(out.work_);
  });
  return out;
}

void OutputFolder::add_inputs(const std::vector<fs::path>& inputs) {
  inputs_.insert(inputs_.end(), inputs.begin(), inputs.end());
  check(named_, target_, overwrite_, inputs_);
}

OutputFolder OutputFolder::in_place(const fs::path& folder) {
  const fs::path target = resolved(folder);
  if (fs::exists(target) && !fs::is_directory(target))
    throw IoError("--out: " + folder.string() + " is a file, expected a folder");
  look_around(folder, target);
  OutputFolder out(folder, target, target);
  out.lock_ = FolderLock(target);
  if (out.lock_.busy()) refuse_busy(folder, target);
  return out;
}

void OutputFolder::commit() {
  if (pending_) put_in_place();
  if (!std::exchange(cleared_, true)) clear_leftovers(target_);
}

void OutputFolder::put_in_place() {
  check(named_, target_, overwrite_, inputs_);  // others may have written there meanwhile
  attempt(target_, "put in its place", [&] {
    fs::path old;
    if (fs::exists(target_)) {
      if (exchanged(work_, target_)) {
        old = work_;
      } else {  // a file system that can only rename
        old = sibling(target_, kReplaced);
        fs::rename(target_, old);
      }
    }
    if (old != work_) {
      try {
        fs::rename(work_, target_);
      } catch (const fs::filesystem_error&) {
        if (!old.empty()) fs::rename(old, target_);
        throw;
      }
    }
    pending_ = false;
    work_ = target_;
    std::error_code failed;
    if (!old.empty()) fs::remove_all(old, failed);
    if (failed)
      log_line(LogLevel::warning,
               old.string() + ": what was replaced cannot be removed (" + failed.message() + ")");
  });
}

void check_output_file(const std::string& flag, const fs::path& file, bool overwrite,
                       const std::vector<fs::path>& inputs) {
  if (file.empty()) return;
  const std::string where = flag + ": " + file.string();
  std::error_code code;
  if (fs::is_directory(file, code)) throw IoError(where + " is a folder, expected a file");
  for (const fs::path& input : inputs) {
    if (input.empty() || !fs::exists(file, code)) continue;
    if (fs::equivalent(file, input, code))
      throw IoError(where + " is an input, expected another name");
    if (fs::is_directory(input, code) && holds(resolved(input), resolved(file)))
      throw IoError(where + " is a file of the input " + input.string() +
                    ", expected another name");
  }
  if (fs::exists(file, code) && !overwrite) throw IoError(where + " exists; use --overwrite");
  // the folder around it, or the one to make that in
  fs::path folder = fs::absolute(file).parent_path();
  while (!fs::exists(folder, code) && folder.has_relative_path()) folder = folder.parent_path();
  if (!fs::is_directory(folder, code))
    throw IoError(where + " cannot be written (" + folder.string() +
                  " is a file), expected a name in a folder");
  if (::access(folder.c_str(), W_OK | X_OK) != 0)
    throw IoError(where + " cannot be written (" + std::generic_category().message(errno) +
                  "), expected a place that can be");
  for (const fs::path& left : remove_partial_files(file.parent_path(), file.filename()))
    log_line(LogLevel::info, left.string() + " removed, left by a stopped run");
}

void check_distinct(const std::vector<fs::path>& files) {
  const auto place = [](const fs::path& file) {
    std::error_code unknown;
    const fs::path real = fs::weakly_canonical(fs::absolute(file, unknown), unknown);
    return unknown ? file : real;
  };
  for (std::size_t a = 0; a < files.size(); ++a)
    for (std::size_t b = a + 1; b < files.size(); ++b)
      if (!files[a].empty() && !files[b].empty() && place(files[a]) == place(files[b]))
        throw IoError(files[a].string() + ": named for two results, expected two names");
}

}  // namespace satsurf::app

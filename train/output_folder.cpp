// SPDX-License-Identifier: Apache-2.0
#include "satsurf/train/output_folder.h"

#include "satsurf/core/error.h"

#include <algorithm>
#include <cstdlib>
#include <string>
#include <system_error>
#include <utility>

#include <unistd.h>

namespace satsurf::train {
namespace {

namespace fs = std::filesystem;

/// Runs a file system operation and turns its failure into our words.
template <class F>
auto attempt(const fs::path& folder, const char* what, const F& operation) {
  try {
    return operation();
  } catch (const fs::filesystem_error& e) {
    throw IoError("out: " + folder.string() + " cannot be " + what + " (" + e.code().message() +
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
  if (folder.empty()) throw IoError("out: the name is empty, expected a folder");
  fs::path path =
      attempt(folder, "found", [&] { return fs::weakly_canonical(fs::absolute(folder)); });
  return path.has_filename() ? path : path.parent_path();  // "out/" is "out"
}

void check(const fs::path& named, const fs::path& target, OutputFolder::Existing existing) {
  using Existing = OutputFolder::Existing;
  attempt(named, "read", [&] {
    if (!fs::exists(target)) return;
    if (!fs::is_directory(target))
      throw IoError("out: " + named.string() + " is a file, expected a folder");
    if (fs::is_empty(target) || existing == Existing::resume) return;
    if (existing == Existing::refuse)
      throw IoError("out: " + named.string() + " exists and is not empty; use --overwrite");
    const char* home = std::getenv("HOME");
    if (holds(target, fs::current_path()) ||
        (home != nullptr && *home != '\0' && holds(target, fs::weakly_canonical(home))))
      throw IoError("out: " + named.string() +
                    " holds the working or the home folder, which --overwrite would remove");
  });
}

fs::path sibling(const fs::path& target, const char* kind) {
  fs::path name = target;
  name += std::string(kind) + std::to_string(::getpid());
  return name;
}

}  // namespace

OutputFolder::OutputFolder(fs::path target, fs::path work)
    : target_(std::move(target)), work_(std::move(work)), pending_(work_ != target_) {}

OutputFolder::OutputFolder(OutputFolder&& other) noexcept
    : target_(std::move(other.target_)),
      work_(std::move(other.work_)),
      pending_(std::exchange(other.pending_, false)) {}

OutputFolder::~OutputFolder() {
  std::error_code ignored;
  if (pending_) fs::remove_all(work_, ignored);
}

OutputFolder OutputFolder::staged(const fs::path& folder, bool overwrite) {
  const fs::path target = resolved(folder), work = sibling(target, ".partial-");
  check(folder, target, overwrite ? Existing::overwrite : Existing::refuse);
  attempt(folder, "made", [&] {
    fs::remove_all(work);  // of a killed process that had our number
    fs::create_directories(work);
  });
  return {target, work};
}

OutputFolder OutputFolder::in_place(const fs::path& folder, Existing existing) {
  const fs::path target = resolved(folder);
  check(folder, target, existing);
  attempt(folder, "made", [&] {
    if (existing == Existing::overwrite) fs::remove_all(target);
    fs::create_directories(target);
  });
  return {target, target};
}

void OutputFolder::commit() {
  if (!pending_) return;
  attempt(target_, "put in its place", [&] {
    const fs::path old = sibling(target_, ".replaced-");
    const bool replaces = fs::exists(target_);
    if (replaces) fs::rename(target_, old);
    try {
      fs::rename(work_, target_);
    } catch (const fs::filesystem_error&) {
      if (replaces) fs::rename(old, target_);
      throw;
    }
    pending_ = false;
    work_ = target_;
    if (replaces) fs::remove_all(old);
  });
}

}  // namespace satsurf::train

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/output_folder.h"

#include "satsurf/app/record.h"
#include "satsurf/core/error.h"

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <string>
#include <system_error>
#include <utility>

#include <unistd.h>

namespace satsurf::app {
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

/// Whether a file or folder lies in `folder`, or a link to it does.
bool lies_in(const fs::path& folder, const fs::path& input) {
  const fs::path name = fs::absolute(input).lexically_normal();
  return holds(folder, fs::weakly_canonical(name)) ||
         holds(folder, fs::weakly_canonical(name.parent_path()) / name.filename());
}

void check(const fs::path& named, const fs::path& target, bool overwrite,
           const std::vector<fs::path>& inputs) {
  attempt(named, "read", [&] {
    if (!fs::exists(target)) return;
    if (!fs::is_directory(target))
      throw IoError("out: " + named.string() + " is a file, expected a folder");
    for (const fs::path& input : inputs)
      if (!input.empty() && lies_in(target, input))
        throw IoError("out: " + named.string() + " holds the input " + input.string() +
                      ", expected a folder of its own");
    if (fs::is_empty(target)) return;
    if (!overwrite)
      throw IoError("out: " + named.string() + " exists and is not empty; use --overwrite");
    const char* home = std::getenv("HOME");
    if (holds(target, fs::current_path()) ||
        (home != nullptr && *home != '\0' && holds(target, fs::weakly_canonical(home))))
      throw IoError("out: " + named.string() +
                    " holds the working or the home folder, which --overwrite would remove");
    if (!holds_run(target))
      throw IoError("out: " + named.string() +
                    " holds no run.json of an earlier run, expected one for --overwrite; name "
                    "another folder");
  });
}

/// The outermost folder that has to be made for `folder`; empty if it exists.
fs::path outermost_missing(fs::path folder) {
  fs::path missing;
  for (; !folder.empty() && !fs::exists(folder); folder = folder.parent_path()) missing = folder;
  return missing;
}

fs::path sibling(const fs::path& target, const char* kind) {
  fs::path name = target;
  name += std::string(kind) + std::to_string(::getpid());
  return name;
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
      overwrite_(other.overwrite_),
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
  check(folder, target, overwrite, inputs);
  OutputFolder out(folder, target, sibling(target, ".partial-"));
  out.inputs_ = std::move(inputs);
  out.overwrite_ = overwrite;
  attempt(folder, "made", [&] {
    fs::remove_all(out.work_);  // of a killed process that had our number
    out.first_made_ = outermost_missing(out.work_);
    fs::create_directories(out.work_);
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
    throw IoError("out: " + folder.string() + " is a file, expected a folder");
  return {folder, target, target};
}

void OutputFolder::commit() {
  if (!pending_) return;
  check(named_, target_, overwrite_, inputs_);  // others may have written there meanwhile
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
}

void check_distinct(const std::vector<fs::path>& files) {
  const auto place = [](const fs::path& file) { return fs::weakly_canonical(fs::absolute(file)); };
  for (std::size_t a = 0; a < files.size(); ++a)
    for (std::size_t b = a + 1; b < files.size(); ++b)
      if (!files[a].empty() && !files[b].empty() && place(files[a]) == place(files[b]))
        throw IoError(files[a].string() + ": named for two results, expected two names");
}

}  // namespace satsurf::app

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>

namespace satsurf::train {

/// Where a command puts its files. A staged folder is filled under a temporary name beside its
/// place and renamed into it by `commit()`; without a commit nothing is left. A folder in place is
/// for runs that can be resumed: its files are there while the run goes on, each written whole.
class OutputFolder {
 public:
  enum class Existing {
    refuse,     ///< a folder that is not empty is an error
    overwrite,  ///< its content is replaced; when staged, by commit() and not before
    resume,     ///< in place, whatever is there stays
  };

  /// throws IoError: `out: DIR exists and is not empty; use --overwrite`; also if DIR is a file, or
  /// if overwriting would remove the working folder, the home folder or one above them
  static OutputFolder staged(const std::filesystem::path& folder, bool overwrite);
  /// The folder itself, made if missing. throws IoError as above
  static OutputFolder in_place(const std::filesystem::path& folder, Existing existing);

  OutputFolder(OutputFolder&& other) noexcept;
  OutputFolder& operator=(OutputFolder&&) = delete;
  ~OutputFolder();

  /// Where to write.
  const std::filesystem::path& path() const { return work_; }
  std::filesystem::path operator/(const std::filesystem::path& name) const { return work_ / name; }
  /// Puts a staged folder in its place; nothing to do for one in place. throws IoError
  void commit();

 private:
  OutputFolder(std::filesystem::path target, std::filesystem::path work);

  std::filesystem::path target_, work_;
  bool pending_;  // work_ must go unless committed
};

}  // namespace satsurf::train

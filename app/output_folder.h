// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/app/folder_lock.h"

#include <filesystem>
#include <string>
#include <vector>

namespace satsurf::app {

/// Where a command puts its files. A staged folder is filled under a temporary name beside its
/// place and renamed into it by `commit()`; without a commit nothing is left, neither the folder
/// nor those made around it. A folder in place is one to go on in: whatever is there stays.
///
/// What killed processes have left in and beside the place is removed by `commit()`, which says so:
/// a run that is refused touches nothing. Folders of processes that live are locked; their place is
/// refused.
class OutputFolder {
 public:
  /// A folder that appears with `commit()`.
  /// overwrite  replace, by commit() and not before, what an earlier run of this program left
  ///            there: a folder that holds its run.json
  /// inputs     files and folders the run reads; none may lie in the folder or be the folder. Empty
  ///            names are passed over
  /// throws     IoError `--out: DIR exists and is not empty; use --overwrite`; also if DIR is a file,
  ///            holds an input, is worked on by another process, or if overwriting would remove
  ///            something else than a run, the working folder, the home folder or one above them
  static OutputFolder staged(const std::filesystem::path& folder, bool overwrite,
                             std::vector<std::filesystem::path> inputs = {});
  /// Names more files the run reads, known only since they are read.
  /// throws  IoError as `staged`
  void add_inputs(const std::vector<std::filesystem::path>& inputs);
  /// The folder itself, as it is.
  /// throws  IoError if it is a file or worked on by another process
  static OutputFolder in_place(const std::filesystem::path& folder);

  OutputFolder(OutputFolder&& other) noexcept;
  OutputFolder& operator=(OutputFolder&&) = delete;
  ~OutputFolder();

  /// Where to write; another place after commit().
  const std::filesystem::path& path() const { return work_; }
  std::filesystem::path operator/(const std::filesystem::path& name) const { return work_ / name; }
  /// Whether the files are where they were asked for.
  bool in_its_place() const { return !pending_; }
  /// Puts a staged folder in its place, which is looked at once more. Where the file system can, old and new are exchanged in one step: there is no moment
  /// without either.
  /// throws  IoError
  void commit();

 private:
  OutputFolder(std::filesystem::path named, std::filesystem::path target,
               std::filesystem::path work);
  void put_in_place();

  std::filesystem::path named_, target_, work_, first_made_;
  std::vector<std::filesystem::path> inputs_;
  FolderLock lock_;
  bool overwrite_ = false, cleared_ = false, pending_;  // pending: work_ must go unless committed
};

/// Looks at a file before the work that ends in it.
/// flag    what asked for it, e.g. `--json`; an empty name is passed over
/// inputs  files and folders the run reads; the file may not be one, nor one of theirs
/// throws IoError: `--json: FILE exists; use --overwrite`; also if it is an input or a folder, or
/// cannot be written where it is
void check_output_file(const std::string& flag, const std::filesystem::path& file, bool overwrite,
                       const std::vector<std::filesystem::path>& inputs);
/// Looks at the files that results go into; empty names are passed over.
/// throws  IoError if two of them are one
void check_distinct(const std::vector<std::filesystem::path>& files);

}  // namespace satsurf::app

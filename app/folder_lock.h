// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <utility>

namespace satsurf::app {

/// A folder that one process works on. The lock is advisory, between runs of this program; it stays
/// with the folder when that is renamed and ends with the process, however that ends.
class FolderLock {
 public:
  /// Holds nothing.
  FolderLock() = default;
  /// Asks for a folder, without waiting.
  explicit FolderLock(const std::filesystem::path& folder);
  FolderLock(FolderLock&& other) noexcept
      : descriptor_(std::exchange(other.descriptor_, -1)), busy_(other.busy_) {}
  FolderLock& operator=(FolderLock&& other) noexcept {
    std::swap(descriptor_, other.descriptor_);
    std::swap(busy_, other.busy_);
    return *this;
  }
  ~FolderLock();

  bool ours() const { return descriptor_ >= 0; }
  /// Another process has it. Neither this nor `ours()` where the folder is not there, and on file
  /// systems that know no locks.
  bool busy() const { return busy_; }

 private:
  int descriptor_ = -1;
  bool busy_ = false;
};

}  // namespace satsurf::app

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/app/output_folder.h"
#include "satsurf/train/training.h"

#include <filesystem>
#include <utility>

namespace satsurf::app {

/// The files of a training run in an output folder. A staged folder takes its place with the first
/// checkpoint: what fails before costs no earlier run.
class TrainingOutput {
 public:
  explicit TrainingOutput(OutputFolder folder)
      : folder_(std::move(folder)), files_(folder_.path()) {}

  std::filesystem::path operator/(const std::filesystem::path& name) const {
    return folder_ / name;
  }
  std::filesystem::path checkpoint() const { return files_.checkpoint(); }
  /// For `TrainingCallbacks::step`.
  void add(const train::StepReport& report) { files_.add(report); }
  /// For `TrainingCallbacks::save`.
  void save(const TensorFile& checkpoint, const TensorFile& weights) {
    files_.save(checkpoint, weights);
    folder_.commit();
    files_.moved_to(folder_.path());
  }

 private:
  OutputFolder folder_;
  train::TrainingFolder files_;
};

}  // namespace satsurf::app

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/train/training.h"

#include <cstdint>
#include <filesystem>
#include <functional>

namespace satsurf::test {

/// Trains into a folder, which is made if there is none.
/// resume  from its checkpoint
/// step    told of every step; returning false stops
template <class Config>
void train_in_folder(const Config& config, const std::filesystem::path& data,
                     const std::filesystem::path& folder, std::uint64_t seed, bool resume = false,
                     const std::function<bool(const train::StepReport&)>& step = {}) {
  std::filesystem::create_directories(folder);
  train::TrainingFolder files(folder);
  train::TrainingCallbacks callbacks;
  callbacks.step = [&](const train::StepReport& r) {
    files.add(r);
    return step ? step(r) : true;
  };
  callbacks.save = [&](const TensorFile& checkpoint, const TensorFile& weights) {
    files.save(checkpoint, weights);
  };
  train::train(config, data, seed, resume ? files.checkpoint() : std::filesystem::path(),
               callbacks);
}

}  // namespace satsurf::test

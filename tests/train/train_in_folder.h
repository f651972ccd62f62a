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
  train::train(config, data, seed,
               resume ? folder / "checkpoint.safetensors" : std::filesystem::path(),
               train::keep_in(folder, step));
}

}  // namespace satsurf::test

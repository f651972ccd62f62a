// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/safetensors.h"
#include "satsurf/nn/lpips.h"

#include <filesystem>
#include <string>

#include "tests/paths.h"

namespace satsurf::test {

/// A network of few channels with known weights, see golden/make_image_golden.py.
inline nn::Lpips small_lpips() {
  const TensorFile golden =
      load_safetensors(test::tests_folder() / "golden" / "image_golden.safetensors");
  TensorFile file;
  const std::string prefix = "lpips.alex.";
  for (const auto& [name, tensor] : golden.tensors)
    if (name.starts_with(prefix)) file.tensors[name.substr(prefix.size())] = tensor.clone();
  return nn::Lpips(file, "alex");
}

}  // namespace satsurf::test

// SPDX-License-Identifier: Apache-2.0
// Weights: a network is made of a file as every command makes it, and so are the parts of a training's checkpoint.
#include "satsurf/core/safetensors.h"
#include "satsurf/nn/adamw.h"
#include "satsurf/nn/lpips.h"
#include "satsurf/nn/running_mean.h"
#include "satsurf/nn/weights_file.h"

#include "tests/fuzz/fuzz.h"
#include "tests/fuzz/mutate_safetensors.h"

namespace satsurf::fuzz {

void run(std::string_view bytes) {
  const auto path = folder().put("w.safetensors", bytes);
  TensorFile file;
  if (!only<IoError>([&] { file = load_safetensors(path); })) return;
  only<IoError>([&] { nn::model_from(file, "w"); });
  only<IoError>([&] { nn::mono_from(file, "w"); });
  only<IoError>([&] { nn::surface_from(file, "w"); });
  only<IoError>([&] { const nn::BasicLpips<float> metric(file, "w"); });
  static nn::SurfaceModel network(nn::SurfaceConfig{1}, 0);
  only<IoError>([&] { nn::AdamW(network.parameters(), {}).load(file, "w"); });
  only<IoError>([&] { nn::RunningMean(network.parameters(), 0.5).load(file, "w"); });
}

}  // namespace satsurf::fuzz

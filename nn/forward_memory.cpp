// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/forward_memory.h"

#include "satsurf/core/block_pool.h"
#include "satsurf/core/parallel.h"
#include "satsurf/nn/cost_net.h"

#include <algorithm>
#include <array>

namespace satsurf::nn {

std::vector<PartMemory> forward_memory(const ModelConfig& config, Index views, Index height,
                                       Index width, Wanted wanted, int workers) {
  if (workers == 0) workers = threads();
  const double N = static_cast<double>(views), b = static_cast<double>(config.base),
               v = static_cast<double>(config.volume_base),
               pixels = static_cast<double>(height * width);
  constexpr double kSurfel = 13, kRaw = 10;  // floats of a surfel, outputs of the head
  constexpr double kScratch = 2e5;           // floats a thread's 3D convolution works in
  std::vector<PartMemory> parts;
  const auto add = [&](const std::string& part, double floats_per_pixel) {
    parts.push_back({part, static_cast<double>(sizeof(float)) * floats_per_pixel * pixels});
  };
  // The last view's features are made beside those of the others: at full resolution a sum of two
  // terms of 4 b channels, from three maps of b, b / 2 and b / 4 and what is kept of them.
  const bool mono = config.mono != MonoBranch::none, fusion = mono && config.fusion != Fusion::none;
  const double m = static_cast<double>(config.mono_net.base);
  std::array<double, 3> mono_maps{mono && learns(wanted) ? 1.0 : 0, fusion ? 0.5 * m : 0,
                                  fusion ? m : 0};
  const double all_mono_maps = mono_maps[0] + mono_maps[1] + mono_maps[2];
  add("features", (N - 1) * (1.75 * b + all_mono_maps) + 10.75 * b + 3);
  double kept = N * (1.75 * b + all_mono_maps + 1);  // features, monocular ones, validity
  // Hypotheses and probabilities of a stage.
  const auto distribution_of = [&](std::size_t s) {
    return 2 * N * static_cast<double>(config.hypotheses[s]) /
           static_cast<double>(kStrides[s] * kStrides[s]);
  };
  // Floats of a stage's volume, as far as it is there at one time, and what the first convolution
  // makes of it.
  const auto first_of = [&](std::size_t s) {
    const Index H = height / kStrides[s], W = width / kStrides[s], C = config.base * kStrides[s],
                channels = C + (config.best_pair ? kPairChannels : 0),
                slice = config.hypotheses[s] * W, row = channels * slice,
                rows = row > 0 ? band_rows(row) : H, pairs = views - 1;
    // The volume is whole and waits for the costs of the pairs: one is swept while those of the others
    // are kept; or of each pair there are the costs, before and behind their concatenation, a hidden
    // layer of 8 and a weight, and 10 channels of the result and what the layers work in.
    if (config.visible_pairs) {
      const Index swept = C + (pairs + 2) * kPairChannels,
                  weighed = (2 * kPairChannels + 8 + 1) * pairs + 10;
      return static_cast<double>(H * (row + slice * std::max(swept, weighed)));
    }
    const Index bands = rows < H ? 2 * (rows + 2) * row : (H + 2) * row;
    return static_cast<double>(bands + H * slice * config.volume_base);
  };
  for (std::size_t s = 0; s < stages_of(wanted); ++s) {
    const double p = 1 / static_cast<double>(kStrides[s] * kStrides[s]);
    const double C = static_cast<double>(config.base * kStrides[s]);
    const double D = static_cast<double>(config.hypotheses[s]);
    const double w = static_cast<double>(config.head_width[s]);
    const std::string stage = " " + std::to_string(s + 1);
    if (s > 0) kept -= N * mono_maps[s];  // fused
    kept += N * p * D;                    // hypotheses
    if (s > 0 && wanted == Wanted::discs) kept -= distribution_of(s - 1);
    if (mono && s < 2) kept += N * p;
    // Of one view the features' pixels, and two bands of the volume with what the first convolution
    // makes of it, or the sum at the U-Net's end; then logits, their concatenation and the
    // probabilities of all views.
    const double scratch = std::min(kScratch * workers, 0.25 * D * p * v * pixels) / pixels;
    const double volume = N * D + N * C + std::max(first_of(s) / (p * pixels), 2.3 * D * v),
                 distribution = 2 * N * D + 2 * N;
    add("volumes" + stage, kept + std::max(p * volume + scratch, p * distribution));
    kept += N * p * (D + 3);  // probability, height, two confidences
    if (wanted != Wanted::surfels) kept -= N * p * C;
    if (wanted == Wanted::discs && s == 2) kept -= distribution_of(s);
    // One view's input, once more in parts, and three layers of the head; then all raw attributes,
    // packed surfels and their attributes.
    const double surfels = N * (kRaw + 2 * kSurfel);
    const bool first_surfels =
        wanted == Wanted::discs ? s == 2 : wanted == Wanted::surfels && s == 0;
    if (first_surfels) kept += 3 * N;  // images
    if (wanted == Wanted::discs && s == 2) add("discs", kept + surfels);
    if (wanted != Wanted::surfels) continue;
    const double images = s < 2 ? 3 * N : 0;
    const double head = 2 * (4 + C + D) + 3 * w + kRaw * (N - 1);
    add("heads" + stage, kept + p * (images + std::max(head, surfels)));
    kept += p * N * kSurfel;
  }
  return parts;
}

double forward_bytes(const ModelConfig& config, Index views, Index height, Index width,
                     Wanted wanted, int workers) {
  double most = 0;
  for (const PartMemory& part : forward_memory(config, views, height, width, wanted, workers))
    most = std::max(most, part.bytes);
  return most;
}

MemoryMeter::MemoryMeter(std::vector<PartMemory>* parts)
    : parts_(parts), before_(tensor_bytes()), most_(peak_tensor_bytes()) {
  if (parts_ == nullptr) return;
  parts_->clear();
  reset_peak_tensor_bytes();
}

MemoryMeter::~MemoryMeter() {
  if (parts_ != nullptr) raise_peak_tensor_bytes(most_);
}

void MemoryMeter::end(const std::string& part) {
  if (parts_ == nullptr) return;
  const std::size_t peak = peak_tensor_bytes();
  parts_->push_back({part, static_cast<double>(peak) - static_cast<double>(before_)});
  most_ = std::max(most_, peak);
  reset_peak_tensor_bytes();
}

}  // namespace satsurf::nn

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/config.h"
#include "satsurf/nn/stage.h"

#include <cstddef>
#include <string>
#include <vector>

namespace satsurf::nn {

/// Most bytes in tensors at one time during one part of a forward pass, its results and what
/// earlier parts left behind included, the scene not.
struct PartMemory {
  std::string part;  ///< "features", "volumes 1", "heads 1", "volumes 2", .., or "discs"
  double bytes = 0;
};

/// What `BasicModel::forward` takes without a tape, foreseen from the sizes of features, volumes,
/// heads and surfels.
/// height, width  of the views, image pixels
/// workers        threads of the pass; 0 for `threads()`
/// returns        the parts in the order of the pass, each within a tenth
std::vector<PartMemory> forward_memory(const ModelConfig& config, Index views, Index height,
                                       Index width, Wanted wanted = Wanted::surfels,
                                       int workers = 0);
/// The largest part.
double forward_bytes(const ModelConfig& config, Index views, Index height, Index width,
                     Wanted wanted = Wanted::surfels, int workers = 0);

/// Notes the most tensor bytes of one part after the other, beyond those at its construction.
class MemoryMeter {
 public:
  /// parts  takes the notes; nullptr for none
  explicit MemoryMeter(std::vector<PartMemory>* parts);
  ~MemoryMeter();  ///< `peak_tensor_bytes()` is what it would have been without
  MemoryMeter(const MemoryMeter&) = delete;
  MemoryMeter& operator=(const MemoryMeter&) = delete;
  /// What has been used since the last call belongs to `part`.
  void end(const std::string& part);

 private:
  std::vector<PartMemory>* parts_;
  std::size_t before_, most_;
};

}  // namespace satsurf::nn

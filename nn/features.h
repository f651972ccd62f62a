// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/config.h"
#include "satsurf/nn/feature_net.h"
#include "satsurf/nn/input.h"
#include "satsurf/nn/mono.h"
#include "satsurf/nn/stage.h"

#include <array>
#include <functional>
#include <optional>

namespace satsurf::nn {

/// What the stages read of N source views. Arrays are by stage, coarse to fine.
template <class T>
struct FeatureMaps {
  std::array<BasicVar<T>, 3> fpn;   ///< [N C_s h w] matching features F_s of the FPN
  std::array<BasicVar<T>, 3> mono;  ///< [N M_s h w] monocular features M_s of stages 2 and 3
  BasicTensor<T> mono_height;       ///< [N H W] relative heights of the monocular branch
  BasicTensor<T> validity;          ///< [N H W] 1 where a view has data, else 0
};

/// The pictures of all views, [N 3 H W] in [0, 1].
template <class T>
BasicTensor<T> stacked_images(const NetworkInput& scene);

/// The networks that look at single views: the FPN, and the monocular branch, which is trained by
/// itself and takes no gradient.
template <class T>
class FeatureExtractor {
 public:
  FeatureExtractor(ParameterSet<T>& p, const ModelConfig& config);
  /// One view after the other: that takes a third of the memory.
  /// scene    source views of one size
  /// poll     called between networks, may throw to stop
  /// wanted   what the maps are for
  /// returns  monocular maps are empty without that branch; its features also without fusion, its
  ///          heights also where no loss may read them
  FeatureMaps<T> operator()(const NetworkInput& scene, const std::function<void()>& poll,
                            Wanted wanted) const;
  /// Channels M_s of the monocular features; 0 without that branch.
  /// stage  counts from 0
  Index mono_channels(std::size_t stage) const;

 private:
  bool fuses_, local_contrast_;
  FeatureNet<T> fpn_;
  std::optional<MonoNet<T>> mono_;
};

}  // namespace satsurf::nn

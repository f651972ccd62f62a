// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/blocks.h"

#include <array>
#include <optional>
#include <vector>

namespace satsurf::nn {

/// The sizes of a FeatureNet.
struct FeatureNetOptions {
  Index base = 8;               ///< b, channels at full resolution
  Index levels = 0;             ///< halvings below stride 4, of 8 b channels each
  bool local_contrast = false;  ///< whether the images have a fourth channel, `locally_normalised`
};

/// Feature pyramid shared by all views. Stride-2 layers are 4 x 4 with padding 1, so that stage
/// pixel i is centred at image pixel (i + 0.5) s - 0.5 exactly.
/// What lies below stride 4 looks around: at stride 16 on some 200 x 200 px. It is added to the
/// features at stride 4, and all that the base network does not have begins at nothing, so that
/// weights trained without it go on as they were.
/// Source: Lin et al. 2017 (FPN), in the form cascade stereo networks use.
template <class T>
class FeatureNet {
 public:
  FeatureNet(ParameterSet<T>& p, const FeatureNetOptions& options);
  /// images   [N 3 H W], each standardised; [N 4 H W] with local contrast
  /// returns  maps at strides 4, 2 and 1: [N 4b H/4 W/4], [N 2b H/2 W/2], [N b H W]
  /// throws   ShapeError
  std::array<BasicVar<T>, 3> operator()(const BasicVar<T>& images) const;

 private:
  FeatureNet(ParameterSet<T>& p, Index base);
  /// One halving below stride 4.
  struct Level {
    ConvNorm2d<T> halve, same;
  };
  /// What the levels below stride 4 add to it.
  BasicVar<T> surroundings(const Normalised<T>& quarter) const;

  ConvNorm2d<T> full1_, full2_, half1_, half2_, half3_, quarter1_, quarter2_, quarter3_;
  Conv2d<T> out_quarter_, lateral_half_, out_half_, lateral_full_, out_full_;
  std::optional<BasicVar<T>> contrast_;  ///< weights of the fourth channel in the first convolution
  std::vector<Level> levels_;
  std::optional<BasicVar<T>> around_;  ///< 1 x 1 weights from the levels to stride 4
};

}  // namespace satsurf::nn

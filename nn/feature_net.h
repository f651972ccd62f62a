// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/blocks.h"

#include <array>

namespace satsurf::nn {

/// Feature pyramid shared by all views. Stride-2 layers are 4 x 4 with padding 1, so that stage
/// pixel i is centred at image pixel (i + 0.5) s - 0.5 exactly.
/// Source: Lin et al. 2017 (FPN), in the form cascade stereo networks use.
template <class T>
class FeatureNet {
 public:
  FeatureNet(ParameterSet<T>& p, Index base);
  /// images   [N 3 H W], each standardised
  /// returns  maps at strides 4, 2 and 1: [N 4b H/4 W/4], [N 2b H/2 W/2], [N b H W]
  /// throws   ShapeError
  std::array<BasicVar<T>, 3> operator()(const BasicVar<T>& images) const;

 private:
  ConvNorm2d<T> full1_, full2_, half1_, half2_, half3_, quarter1_, quarter2_, quarter3_;
  Conv2d<T> out_quarter_, lateral_half_, out_half_, lateral_full_, out_full_;
};

}  // namespace satsurf::nn

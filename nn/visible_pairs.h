// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/quadratic.h"
#include "satsurf/nn/blocks.h"
#include "satsurf/ops/cost_volume.h"

#include <string>
#include <vector>

namespace satsurf::nn {

/// Costs of the pairs of the reference with each other view, weighed by a visibility that two small
/// 3D convolutions make of a pair's costs at all heights: where none matches the view does not show
/// the point.
/// Source: after Zhang et al. 2020 (Vis-MVSNet) and Xu and Tao 2020 (PVSNet); ops/visible_mean.h.
template <class T>
class VisiblePairs {
 public:
  VisiblePairs(ParameterSet<T>& p, const std::string& name);
  /// Arguments and errors are those of `plane_sweep_variance`.
  /// returns  [kPairChannels D H W]
  BasicVar<T> operator()(const BasicVar<T>& features, Index reference,
                         const std::vector<Quadratic>& maps, const BasicTensor<T>& heights,
                         const BasicTensor<T>& valid) const;

 private:
  ConvNorm3d<T> hidden_;
  BasicVar<T> weight_;
};

}  // namespace satsurf::nn

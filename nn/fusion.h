// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/blocks.h"
#include "satsurf/nn/config.h"

#include <optional>
#include <string>

namespace satsurf::nn {

/// Confidence-aware fusion (CMMF) of a stage's matching features F with monocular ones M, pixel by
/// pixel: the less confidence C the stage before had in its heights, the more of M.
///   b = lambda (C - tau);  l_mvs = <q(F), k_m(F)> / sqrt(d) + b;  l_mono = <q(F), k_o(M)> / sqrt(d)
///   - b;  W = softmax(l_mvs, l_mono)_mono;  F' = (1 - W) v_m(F) + W v_o(M)
/// with 1 x 1 convolutions q, k, v and d the channels of F. By `fusion_start` of the configuration:
///   paper     as it stands, v_o zero at the start: then F' = (1 - W) v_m(F)
///   gated     a learned offset of -4 to begin with goes to l_mono, v_m starts as the identity and q
///             at zero: F' = F within 3 %. The gate hardly opens: after 2400 steps W was 0.02 still
///   additive  F' = v_m(F) + W v_o(M), v_m the identity, v_o and q zero at the start: F' = F then,
///             with W = sigmoid(-2 b), as the confidence alone has it
/// `naive` fusion is one 1 x 1 convolution of F and M stacked.
/// Source: SatSurfGS, confidence-aware monocular multi-view feature fusion.
template <class T>
class FeatureFusion {
 public:
  /// channels       of F and F'
  /// mono_channels  of M, 0 where there is no monocular branch: F' = v_m(F), or F if naive
  FeatureFusion(ParameterSet<T>& p, const std::string& name, const ModelConfig& config,
                Index channels, Index mono_channels);
  /// features    [N C h w]
  /// mono        [N M h w], or an empty Var without a branch
  /// confidence  [N h w] of the stage before, in [0, 1]
  /// returns     [N C h w]
  /// throws      ShapeError
  BasicVar<T> operator()(const BasicVar<T>& features, const BasicVar<T>& mono,
                         const BasicTensor<T>& confidence) const;
  /// The same with the confidence as the stage before has it, view by view: what is in between is
  /// large.
  /// features    [N C h w]
  /// mono        [N M h w], or an empty Var without a branch
  /// confidence  [N h' w'], bilinear from there
  /// returns     [N C h w]
  BasicVar<T> fuse_views(const BasicVar<T>& features, const BasicVar<T>& mono,
                         const BasicTensor<T>& confidence) const;

 private:
  bool naive_, additive_;
  double lambda_, tau_;
  std::optional<Conv2d<T>> joined_;  // naive
  std::optional<Conv2d<T>> query_, key_features_, value_features_, key_mono_, value_mono_;
  BasicVar<T> offset_;  ///< [1] of l_mono, gated
};

}  // namespace satsurf::nn

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/ops/normalised.h"

namespace satsurf {

/// Group normalisation and activation:
///   y = act(gamma_c (x - mean_g) / sqrt(var_g + epsilon) + beta_c)
/// with moments over the channels of group g and all positions of one batch element (biased
/// variance).
/// Source: Wu and He 2018, eq. 1-2; the activation is fused (ours).
/// x            [B C ...], rank 3 to 5
/// gamma, beta  [C]
/// groups       divides C
/// activation   applied to the result
/// epsilon      added to the variance
/// moments      of x's channels, if whoever made x has gathered them
/// returns      x's shape, left to whoever reads it (ops/normalised.h)
/// throws       ShapeError
template <class T>
Normalised<T> group_normalised(const BasicVar<T>& x, const BasicVar<T>& gamma,
                               const BasicVar<T>& beta, Index groups,
                               Activation activation = Activation::none, T epsilon = T(1e-5),
                               const ChannelMoments* moments = nullptr);

}  // namespace satsurf

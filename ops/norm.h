// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/var.h"

namespace satsurf {

/// What a normalisation applies to its result before it is stored.
enum class Activation { none, relu, gelu };

/// Group normalisation and activation in one pass:
///   y = act(gamma_c (x - mean_g) / sqrt(var_g + epsilon) + beta_c)
/// with moments over the channels of group g and all positions of one batch element (biased
/// variance).
/// Source: Wu and He 2018, eq. 1-2; the activation is fused (ours).
/// x            [B C ...], rank 3 to 5
/// gamma, beta  [C]
/// groups       divides C
/// activation   applied to the result
/// epsilon      added to the variance
/// returns      x's shape
/// throws       ShapeError
/// memory       backward keeps x itself and two numbers per group; without a tape a temporary's
///              buffer takes the result
template <class T>
BasicVar<T> group_norm(BasicVar<T> x, const BasicVar<T>& gamma, const BasicVar<T>& beta,
                       Index groups, Activation activation = Activation::none, T epsilon = T(1e-5));

}  // namespace satsurf

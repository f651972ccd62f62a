// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/var.h"

namespace satsurf {

/// How far the directions of feature vectors are apart, on average over images and pixels:
///   mean_{b,y,x} sum_c weight_c (f_c / (|f| + 1e-10) - r_c / (|r| + 1e-10))^2
/// Source: Zhang et al. 2018 (LPIPS), eq. 1, one layer of it.
/// features   [B C H W]; a pixel without any feature passes no gradient on
/// reference  [B C H W], no gradient
/// weight     [C], no gradient
/// returns    a scalar
/// throws     ShapeError
template <class T>
BasicVar<T> feature_distance(const BasicVar<T>& features, const BasicTensor<T>& reference,
                             const BasicTensor<T>& weight);

}  // namespace satsurf

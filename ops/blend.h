// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/var.h"

namespace satsurf {

/// Inner products of the channels of two maps, pixel by pixel:
///   out[n,y,x] = sum_c a[n,c,y,x] b[n,c,y,x]
/// a, b     [N C H W]
/// returns  [N H W]
/// throws   ShapeError
template <class T>
BasicVar<T> channel_dot(const BasicVar<T>& a, const BasicVar<T>& b);

/// One map, and another with a weight per pixel:
///   out[n,c,y,x] = a[n,c,y,x] + weight[n,y,x] b[n,c,y,x]
/// a, b     [N C H W]
/// weight   [N H W]
/// returns  [N C H W]
/// throws   ShapeError
template <class T>
BasicVar<T> add_weighted(const BasicVar<T>& a, const BasicVar<T>& weight, const BasicVar<T>& b);

}  // namespace satsurf

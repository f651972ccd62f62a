// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/var.h"

namespace satsurf {

/// Nearest neighbour, half-pixel centres: out pixel i reads in pixel floor((i + 0.5) H / H').
/// x              [... H W], rank 2 to 5
/// height, width  of the result, px
/// returns        [... height width]
/// throws         ShapeError
template <class T>
BasicVar<T> resize_nearest(const BasicVar<T>& x, Index height, Index width);

/// Bilinear, half-pixel centres, border values repeated:
///   out pixel i sits at (i + 0.5) H / H' - 0.5
/// No antialiasing: to shrink by an integer factor, use `area_downsample`.
/// x              [... H W], rank 2 to 5
/// height, width  of the result, px
/// returns        [... height width]
/// throws         ShapeError
template <class T>
BasicVar<T> resize_bilinear(const BasicVar<T>& x, Index height, Index width);

/// Mean over factor x factor blocks.
/// x        [... H W], rank 2 to 5
/// factor   divides H and W
/// returns  [... H/factor W/factor]
/// throws   ShapeError
template <class T>
BasicVar<T> area_downsample(const BasicVar<T>& x, Index factor);

}  // namespace satsurf

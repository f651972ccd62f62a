// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/var.h"

namespace satsurf {

/// Of a 2D pooling; windows are square.
struct PoolOptions {
  Index kernel = 2, stride = 2;
  bool ceil_mode = false;  ///< a last window may reach over the border, if it begins before it
};

/// Largest element of each window; NaN wins. The gradient goes to the first of equal ones.
/// x        [B C H W]
/// returns  [B C H' W'] with H' = (H - kernel) / stride + 1, rounded down, or up in ceil mode;
///          likewise W'
/// throws   ShapeError, ConfigError for a kernel or stride below 1
template <class T>
BasicVar<T> max_pool2d(const BasicVar<T>& x, const PoolOptions& options);

}  // namespace satsurf

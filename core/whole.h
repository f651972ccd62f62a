// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/shape.h"

#include <cmath>

namespace satsurf {

/// The whole number at or below `v`. What C++ leaves undefined, numbers that no Index holds, becomes 2^53 or its negative,
/// and NaN the latter: beyond the edge of any image or grid, and far enough from an Index's own to be added to.
inline Index floored(double v) {
  constexpr Index kMost = Index{1} << 53;
  if (!(v > -static_cast<double>(kMost))) return -kMost;
  return v < static_cast<double>(kMost) ? static_cast<Index>(std::floor(v)) : kMost;
}

}  // namespace satsurf

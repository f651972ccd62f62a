// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/var.h"

#include <vector>

namespace satsurf {

/// Joins along `axis`; all other extents are equal. throws ShapeError
template <class T>
BasicVar<T> concat(const std::vector<BasicVar<T>>& parts, Index axis);
/// Elements begin..end-1 along `axis`. throws ShapeError
template <class T>
BasicVar<T> slice(const BasicVar<T>& x, Index axis, Index begin, Index end);
/// The same elements in the same order under another shape (the buffer is shared). throws
/// ShapeError
template <class T>
BasicVar<T> reshape(const BasicVar<T>& x, const Shape& shape);
/// One row per pixel: [N C H W] -> [N*H*W C]. throws ShapeError
template <class T>
BasicVar<T> pixels_from_map(const BasicVar<T>& x);

}  // namespace satsurf

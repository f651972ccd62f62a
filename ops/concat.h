// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/var.h"

#include <vector>

namespace satsurf {

/// Joins along one axis.
/// parts    one or more, equal in all other extents
/// axis     0 to rank - 1
/// returns  the parts' shape, their extents added up along `axis`
/// throws   ShapeError
template <class T>
BasicVar<T> concat(const std::vector<BasicVar<T>>& parts, Index axis);

/// A stretch of one axis.
/// x           any shape
/// axis        0 to rank - 1
/// begin, end  elements begin..end-1 are taken
/// returns     x's shape with `end - begin` along `axis`
/// throws      ShapeError
template <class T>
BasicVar<T> slice(const BasicVar<T>& x, Index axis, Index begin, Index end);

/// The same elements in the same order under another shape.
/// x        any shape
/// shape    as many elements as x has
/// returns  `shape`
/// throws   ShapeError
/// memory   none: the buffer is shared
template <class T>
BasicVar<T> reshape(const BasicVar<T>& x, const Shape& shape);

}  // namespace satsurf

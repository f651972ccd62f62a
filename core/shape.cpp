// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/shape.h"

namespace satsurf {

Shape::Shape(std::span<const Index> extents) {
  if (static_cast<Index>(extents.size()) > kMaxRank)
    throw ShapeError("Shape: rank " + std::to_string(extents.size()) + ", expected at most 5");
  for (const Index e : extents) {
    if (e < 0) throw ShapeError("Shape: negative extent " + std::to_string(e));
    extents_[static_cast<std::size_t>(rank_++)] = e;
  }
}

Index Shape::count() const { return count(0, rank_); }

Index Shape::count(Index first, Index last) const {
  Index n = 1;
  for (Index a = first; a < last; ++a) n *= (*this)[a];
  return n;
}

Shape Shape::with(Index axis, Index extent) const {
  Shape s = *this;
  s.extents_[static_cast<std::size_t>(axis)] = extent;
  return s;
}

std::string Shape::str() const {
  std::string s = "[";
  for (Index a = 0; a < rank_; ++a) {
    if (a > 0) s += ',';
    s += std::to_string((*this)[a]);
  }
  return s += ']';
}

}  // namespace satsurf

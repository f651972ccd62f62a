// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/shape.h"

namespace satsurf {
namespace {

constexpr Index kMostElements = Index{1} << 59;  // the bytes of doubles stay within an Index

}  // namespace

Shape::Shape(std::span<const Index> extents) {
  if (std::ssize(extents) > kMaxRank)
    throw ShapeError("Shape: rank " + std::to_string(extents.size()) + ", expected at most 5");
  Index n = 1;
  bool overflow = false;
  for (const Index e : extents) {
    if (e < 0) throw ShapeError("Shape: extent " + std::to_string(e) + ", expected 0 or more");
    extents_[rank_++] = e;
    overflow = overflow || __builtin_mul_overflow(n, e > 0 ? e : 1, &n) || n > kMostElements;
  }
  if (overflow) throw ShapeError("Shape: " + str() + ", expected at most 2^59 elements");
}

Index Shape::count() const { return count(0, rank_); }

Index Shape::count(Index first, Index last) const {
  Index n = 1;
  for (Index a = first; a < last; ++a) n *= (*this)[a];
  return n;
}

Shape Shape::with(Index axis, Index extent) const {
  Shape s = *this;
  s.extents_[axis] = extent;
  return Shape(s.extents());
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

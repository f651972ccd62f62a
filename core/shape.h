// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/error.h"

#include <array>
#include <cstddef>
#include <cstdint>
#include <initializer_list>
#include <span>
#include <string>

namespace satsurf {

/// Signed extent and index type of the whole engine.
using Index = std::ptrdiff_t;

/// Extents of a contiguous row-major tensor, rank 0 (a scalar) to 5. Prints as `[4,3,2]`.
class Shape {
 public:
  static constexpr Index kMaxRank = 5;  // view or batch, channel, hypothesis, row, column

  Shape() = default;
  /// throws  ShapeError if the rank exceeds 5, an extent is negative, or there are too many
  ///         elements
  Shape(std::initializer_list<Index> extents) : Shape(std::span(extents.begin(), extents.size())) {}
  explicit Shape(std::span<const Index> extents);

  Index rank() const { return rank_; }
  Index operator[](Index axis) const { return extents_[axis]; }
  /// Number of elements; 1 for a scalar.
  Index count() const;
  /// Product of the extents of axes first..last-1; 1 if empty.
  Index count(Index first, Index last) const;
  std::span<const Index> extents() const { return std::span(extents_.data(), rank_); }
  /// The same shape with one extent replaced.
  Shape with(Index axis, Index extent) const;
  /// `[4,3,2]`
  std::string str() const;

  friend bool operator==(const Shape&, const Shape&) = default;

 private:
  std::array<Index, kMaxRank> extents_{};  // unused entries stay 0 so that == may compare all
  Index rank_ = 0;
};

}  // namespace satsurf

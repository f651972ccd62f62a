// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/tensor.h"

#include <cstddef>
#include <cstdint>
#include <variant>
#include <vector>

namespace satsurf {

/// A tensor in a quarter or half of its memory, for what is kept for long and needed in parts.
class PackedTensor {
 public:
  PackedTensor() = default;
  /// As it is, sharing its buffer.
  explicit PackedTensor(const Tensor& t) : shape_(t.shape()), elements_(t) {}
  /// In 8 bits if every element is exactly one of the multiples 0 to 255 of `unit`; else as it is.
  /// Nothing is lost.
  static PackedTensor levels(const Tensor& t, float unit);
  /// In half precision (IEEE 754 binary16), rounded to the nearest: 11 significant bits; beyond 65504
  /// infinite, below 3e-8 zero.
  static PackedTensor halves(const Tensor& t);

  const Shape& shape() const { return shape_; }
  bool empty() const { return bytes() == 0; }
  /// Memory of the elements.
  std::size_t bytes() const;
  /// All elements; a tensor that is kept as it is shares its buffer.
  Tensor tensor() const;
  /// Elements [begin, begin + count) in row-major order.
  void read(Index begin, Index count, float* to) const;

 private:
  using Levels = std::vector<std::uint8_t>;
  using Halves = std::vector<std::uint16_t>;

  Shape shape_;
  float unit_ = 1;  ///< of the levels
  std::variant<Tensor, Levels, Halves> elements_;
};

}  // namespace satsurf

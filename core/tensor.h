// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/shape.h"

#include <initializer_list>
#include <memory>
#include <type_traits>
#include <vector>

namespace satsurf {

/// Contiguous row-major array whose buffer is 64-byte aligned and shared between copies.
/// Copying is cheap and aliases; `clone()` copies the elements.
template <class T>
class BasicTensor {
 public:
  /// An empty tensor: no buffer, `empty()` is true.
  BasicTensor() = default;
  /// Elements are zero.
  explicit BasicTensor(const Shape& shape);
  /// Elements are `fill`.
  BasicTensor(const Shape& shape, T fill);
  /// Elements are indeterminate; for outputs of which every element gets written.
  static BasicTensor uninitialised(const Shape& shape);
  /// Zeros of another tensor's shape; empty if that is.
  static BasicTensor zeros_like(const BasicTensor& other) {
    return other.empty() ? BasicTensor() : BasicTensor(other.shape());
  }
  /// A copy of values in row-major order.
  /// throws  ShapeError if their number is not the shape's
  static BasicTensor from(const Shape& shape, std::span<const T> values);
  static BasicTensor from(const Shape& shape, std::initializer_list<T> values) {
    return from(shape, std::span<const T>(values.begin(), values.size()));
  }
  static BasicTensor scalar(T value) { return BasicTensor(Shape{}, value); }

  const Shape& shape() const { return shape_; }
  Index dim(Index axis) const { return shape_[axis]; }
  Index rank() const { return shape_.rank(); }
  Index count() const { return empty() ? 0 : shape_.count(); }
  bool empty() const { return buffer_ == nullptr; }
  /// Whether this is the only tensor that sees its buffer.
  bool unshared() const { return buffer_.use_count() == 1; }

  T* data() { return buffer_.get(); }
  const T* data() const { return buffer_.get(); }
  T& operator[](Index i) { return buffer_.get()[i]; }
  const T& operator[](Index i) const { return buffer_.get()[i]; }
  std::span<T> values() & { return std::span(data(), count()); }
  std::span<const T> values() const& { return std::span(data(), count()); }
  void values() && = delete;  // the elements would be gone before they are read
  /// The only element.
  /// throws  ShapeError if there are more or fewer
  T item() const;

  /// A copy of the elements in a buffer of its own.
  BasicTensor clone() const;
  /// The same buffer under another shape.
  /// throws  ShapeError if the numbers of elements differ
  BasicTensor reshaped(const Shape& shape) const;
  /// The contiguous block number `i` along axis 0, copied: shape without its first extent.
  BasicTensor slice0(Index i) const;
  /// The elements converted one by one.
  template <class U>
  BasicTensor<U> cast() const {
    if (empty()) return {};
    if constexpr (std::is_same_v<T, U>) {
      return clone();
    } else {
      auto out = BasicTensor<U>::uninitialised(shape_);
      const Index n = count();
      for (Index i = 0; i < n; ++i) out[i] = static_cast<U>((*this)[i]);
      return out;
    }
  }
  void fill(T value);

 private:
  Shape shape_;
  std::shared_ptr<T> buffer_;
};

using Tensor = BasicTensor<float>;

}  // namespace satsurf

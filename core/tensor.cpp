// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/tensor.h"

#include "satsurf/core/block_pool.h"
#include "satsurf/core/parallel.h"

#include <algorithm>
#include <limits>

namespace satsurf {

template <class T>
BasicTensor<T> BasicTensor<T>::uninitialised(const Shape& shape) {
  BasicTensor t;
  t.shape_ = shape;
  const std::size_t bytes = static_cast<std::size_t>(shape.count()) * sizeof(T);
  t.buffer_ = std::shared_ptr<T>(static_cast<T*>(detail::take_block(bytes)),
                                 [bytes](T* p) { detail::give_block(p, bytes); });
#ifdef SATSURF_CHECKED
  // What is read before it is written shows, even where it is multiplied by zero.
  std::fill_n(t.buffer_.get(), shape.count(), std::numeric_limits<T>::quiet_NaN());
#endif
  return t;
}

template <class T>
BasicTensor<T>::BasicTensor(const Shape& shape) : BasicTensor(shape, T(0)) {}

template <class T>
BasicTensor<T>::BasicTensor(const Shape& shape, T fill) : BasicTensor(uninitialised(shape)) {
  this->fill(fill);
}

template <class T>
BasicTensor<T> BasicTensor<T>::from(const Shape& shape, std::span<const T> values) {
  if (std::ssize(values) != shape.count())
    throw ShapeError("Tensor::from: " + std::to_string(values.size()) + " values, expected " +
                     std::to_string(shape.count()) + " for shape " + shape.str());
  BasicTensor t = uninitialised(shape);
  std::copy(values.begin(), values.end(), t.data());
  return t;
}

template <class T>
T BasicTensor<T>::item() const {
  if (count() != 1)
    throw ShapeError("Tensor::item: shape " + shape_.str() + ", expected one element");
  return (*this)[0];
}

template <class T>
BasicTensor<T> BasicTensor<T>::clone() const {
  if (empty()) return {};
  BasicTensor t = uninitialised(shape_);
  std::copy_n(data(), count(), t.data());
  return t;
}

template <class T>
BasicTensor<T> BasicTensor<T>::reshaped(const Shape& shape) const {
  if (empty() || shape.count() != shape_.count())
    throw ShapeError("Tensor::reshaped: from " + (empty() ? "empty" : shape_.str()) + " to " +
                     shape.str() + ", expected equal counts");
  BasicTensor t = *this;
  t.shape_ = shape;
  return t;
}

template <class T>
BasicTensor<T> BasicTensor<T>::slice0(Index i) const {
  if (rank() < 1 || i < 0 || i >= dim(0))
    throw ShapeError("Tensor::slice0: index " + std::to_string(i) +
                     ", expected one of axis 0 of shape " + shape_.str());
  const Shape rest(shape_.extents().subspan(1));
  return from(rest, std::span<const T>(data() + i * rest.count(), rest.count()));
}

template <class T>
void BasicTensor<T>::fill(T value) {
  constexpr Index kPiece = 1 << 16;  // one thread alone does not reach the memory's bandwidth
  T* to = data();
  for_range(count(), kPiece,
            [to, value](Index begin, Index end) { std::fill(to + begin, to + end, value); });
}

template class BasicTensor<float>;
template class BasicTensor<double>;

}  // namespace satsurf

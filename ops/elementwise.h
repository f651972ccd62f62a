// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/var.h"

#include <utility>

namespace satsurf {

/// a + b, element by element.
/// a, b     equal shapes
/// returns  their shape
/// throws   ShapeError
/// memory   without a tape a temporary's buffer takes the sum
template <class T>
BasicVar<T> add(BasicVar<T> a, BasicVar<T> b);

/// a - b, element by element.
/// a, b     equal shapes
/// returns  their shape
/// throws   ShapeError
template <class T>
BasicVar<T> sub(const BasicVar<T>& a, const BasicVar<T>& b);

/// a * b, element by element.
/// a, b     equal shapes
/// returns  their shape
/// throws   ShapeError
template <class T>
BasicVar<T> mul(const BasicVar<T>& a, const BasicVar<T>& b);

/// factor * x + offset, both plain numbers.
/// x        any shape
/// returns  x's shape
template <class T>
BasicVar<T> affine(const BasicVar<T>& x, T factor, T offset);

/// max(x, 0); gradient 0 at 0.
/// x        any shape
/// returns  x's shape
template <class T>
BasicVar<T> relu(const BasicVar<T>& x);

/// x Phi(x) with the exact normal distribution function.
/// Source: Hendrycks and Gimpel 2016.
/// x        any shape
/// returns  x's shape
template <class T>
BasicVar<T> gelu(const BasicVar<T>& x);

/// 1 / (1 + exp(-x)), without overflow for any x.
/// x        any shape
/// returns  x's shape
template <class T>
BasicVar<T> sigmoid(const BasicVar<T>& x);

/// As `add`, `sub` and `mul`.
template <class T>
BasicVar<T> operator+(BasicVar<T> a, BasicVar<T> b) {
  return add(std::move(a), std::move(b));
}
template <class T>
BasicVar<T> operator-(const BasicVar<T>& a, const BasicVar<T>& b) {
  return sub(a, b);
}
template <class T>
BasicVar<T> operator*(const BasicVar<T>& a, const BasicVar<T>& b) {
  return mul(a, b);
}

}  // namespace satsurf

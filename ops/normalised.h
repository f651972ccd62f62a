// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/var.h"

#include <cstddef>
#include <utility>
#include <vector>

namespace satsurf {

/// What follows a normalisation.
enum class Activation { none, relu, gelu };

/// A value that exists as what it is made from, until somebody reads it:
///   value[b,c,..] = act(scale[b,c] (x[b,c,..] - centre[b,c]) + shift[b,c])
/// Convolutions take it as their input and compute it while they read; so neither a pass over
/// memory nor a tensor is spent on it. `materialise` makes a tensor of it.
template <class T>
struct Normalised {
  BasicVar<T> x;       ///< [B C ...], rank 3 to 5
  BasicVar<T> affine;  ///< [3 B C]: centre, scale, shift; empty for x itself
  Activation activation = Activation::none;

  Normalised() = default;
  /// A plain value.
  Normalised(BasicVar<T> plain) : x(std::move(plain)) {}  // NOLINT: meant to convert
  Normalised(BasicVar<T> of, BasicVar<T> by, Activation act)
      : x(std::move(of)), affine(std::move(by)), activation(act) {}

  const Shape& shape() const { return x.shape(); }
  Index dim(Index axis) const { return x.dim(axis); }
};

/// relu(x), left to the next reader.
template <class T>
Normalised<T> then_relu(BasicVar<T> x) {
  return {std::move(x), {}, Activation::relu};
}

/// The value itself.
/// returns  x's shape
/// throws   ShapeError
/// memory   backward keeps x; without a tape a temporary's buffer takes the result
template <class T>
BasicVar<T> materialise(Normalised<T> value);

/// The sum of two values in one pass.
/// a, b     equal shapes
/// returns  their shape
/// throws   ShapeError
/// memory   as `materialise`
template <class T>
BasicVar<T> add(Normalised<T> a, Normalised<T> b);

/// A map added to every slice of a volume along its depth.
/// volume   [B C D H W]
/// map      [B C H W]
/// returns  volume's shape
/// throws   ShapeError
/// memory   as `materialise`
template <class T>
BasicVar<T> add_map(Normalised<T> volume, const BasicVar<T>& map);

/// Number, mean and sum of squared deviations of some elements.
struct Moments {
  double count = 0, mean = 0, m2 = 0;

  /// Those of `n` elements from their sums about `centre`, sum(x - centre) and sum((x - centre)^2).
  static Moments about(double centre, double n, double sum, double squares);
  /// Takes the elements of another in.
  /// Source: Chan, Golub and LeVeque 1979, eq. 2.1
  void merge(const Moments& other);
};

/// The moments of every channel of every image, [B C] in row-major order.
using ChannelMoments = std::vector<Moments>;

template <class T>
ChannelMoments channel_moments(const BasicTensor<T>& x);

namespace detail {
/// Throws ShapeError unless `affine` fits x.
template <class T>
void check_normalised(const char* op, const Normalised<T>& value);
/// Adds to the gradients of x and affine, inputs i and i + 1 of a recorded op, what `dz`, the
/// gradient of the value, means for them.
template <class T>
void normalised_backward(Node<T>& n, std::size_t i, Activation activation, const T* dz);
/// d += scale (x - centre) + shift
/// affine  [3 B C]
template <class T>
void add_affine(const BasicTensor<T>& x, const BasicTensor<T>& affine, T* d);
}  // namespace detail

}  // namespace satsurf

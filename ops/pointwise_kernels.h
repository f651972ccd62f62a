// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/isa.h"
#include "satsurf/core/shape.h"

namespace satsurf {

enum class Activation;

/// How one row (b, c) is normalised: z = scale (x - centre) + shift.
template <class T>
struct NormRow {
  T centre, scale, shift;
};

/// The rows of an affine tensor [3 rows], or of none for the identity.
template <class T>
class NormRows {
 public:
  NormRows(const T* affine, Index rows) : affine_(affine), rows_(rows) {}
  NormRow<T> operator[](Index row) const {
    if (affine_ == nullptr) return {T(0), T(1), T(0)};
    return {affine_[row], affine_[rows_ + row], affine_[2 * rows_ + row]};
  }

 private:
  const T* affine_;
  Index rows_;
};

/// The loops of elementwise.cpp, norm.cpp and normalised.cpp for one instruction set. With
/// `accumulate`, d += instead of d =. Sums are taken in lanes of T for short runs and in double
/// between them, in a fixed order.
template <class T>
struct PointwiseKernels {
  /// d = g where y > 0, else 0
  void (*relu_backward)(Index n, const T* y, const T* g, bool accumulate, T* d);
  /// y = x Phi(x)
  void (*gelu)(Index n, const T* x, T* y);
  /// d = g (Phi(x) + x phi(x))
  void (*gelu_backward)(Index n, const T* x, const T* g, bool accumulate, T* d);
  /// y = 1 / (1 + exp(-x))
  void (*logistic)(Index n, const T* x, T* y);

  /// sums[0] = sum(x - shift), sums[1] = sum((x - shift)^2)
  void (*norm_sums)(Index n, const T* x, T shift, double* sums);
  /// y = base + act(z), z = scale (x - centre) + shift; no base if nullptr
  void (*norm_apply)(Index n, const T* x, const NormRow<T>& row, Activation activation,
                     const T* base, T* y);
  /// dz = g act'(z), d = scale dz; sums[0] = sum(dz), sums[1] = sum(dz (x - centre)); d may be
  /// nullptr
  void (*norm_backward)(Index n, const T* x, const T* g, const NormRow<T>& row,
                        Activation activation, bool accumulate, T* d, double* sums);
  /// d += z
  void (*norm_add_linear)(Index n, const T* x, const NormRow<T>& row, T* d);

  template <Isa isa>
  static PointwiseKernels compiled_for();
};

}  // namespace satsurf

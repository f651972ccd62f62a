// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/shape.h"

// Inner loops of elementwise.cpp, norm.cpp and normalised.cpp, declared once per instruction set
// (core/isa.h):
//   relu_backward    d = g where y > 0, else 0
//   gelu             y = x Phi(x)
//   gelu_backward    d = g (Phi(x) + x phi(x))
//   logistic         y = 1 / (1 + exp(-x))
//   softplus         y = log(1 + exp(x))
//   softplus_backward  d = g / (1 + exp(-x))
//   norm_sums        sums[0] = sum(x - shift), sums[1] = sum((x - shift)^2)
//   norm_apply       y = base + act(z), z = scale (x - centre) + shift; no base if nullptr
//   norm_backward    dz = g act'(z), d = scale dz; sums[0] = sum(dz), sums[1] = sum(dz (x -
//                    centre)); d may be nullptr
//   norm_add_linear  d += z
// With `accumulate`, d += instead of d =. Sums are taken in lanes of T for short runs and in double
// between them, in a fixed order.

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

namespace isa_baseline {
template <class T>
void relu_backward(Index n, const T* y, const T* g, bool accumulate, T* d);
template <class T>
void gelu(Index n, const T* x, T* y);
template <class T>
void gelu_backward(Index n, const T* x, const T* g, bool accumulate, T* d);
template <class T>
void logistic(Index n, const T* x, T* y);
template <class T>
void softplus(Index n, const T* x, T* y);
template <class T>
void softplus_backward(Index n, const T* x, const T* g, bool accumulate, T* d);
template <class T>
void norm_sums(Index n, const T* x, T shift, double* sums);
template <class T>
void norm_apply(Index n, const T* x, const NormRow<T>& row, Activation activation, const T* base,
                T* y);
template <class T>
void norm_backward(Index n, const T* x, const T* g, const NormRow<T>& row, Activation activation,
                   bool accumulate, T* d, double* sums);
template <class T>
void norm_add_linear(Index n, const T* x, const NormRow<T>& row, T* d);
}  // namespace isa_baseline

namespace isa_avx2 {
template <class T>
void relu_backward(Index n, const T* y, const T* g, bool accumulate, T* d);
template <class T>
void gelu(Index n, const T* x, T* y);
template <class T>
void gelu_backward(Index n, const T* x, const T* g, bool accumulate, T* d);
template <class T>
void logistic(Index n, const T* x, T* y);
template <class T>
void softplus(Index n, const T* x, T* y);
template <class T>
void softplus_backward(Index n, const T* x, const T* g, bool accumulate, T* d);
template <class T>
void norm_sums(Index n, const T* x, T shift, double* sums);
template <class T>
void norm_apply(Index n, const T* x, const NormRow<T>& row, Activation activation, const T* base,
                T* y);
template <class T>
void norm_backward(Index n, const T* x, const T* g, const NormRow<T>& row, Activation activation,
                   bool accumulate, T* d, double* sums);
template <class T>
void norm_add_linear(Index n, const T* x, const NormRow<T>& row, T* d);
}  // namespace isa_avx2

namespace isa_avx512 {
template <class T>
void relu_backward(Index n, const T* y, const T* g, bool accumulate, T* d);
template <class T>
void gelu(Index n, const T* x, T* y);
template <class T>
void gelu_backward(Index n, const T* x, const T* g, bool accumulate, T* d);
template <class T>
void logistic(Index n, const T* x, T* y);
template <class T>
void softplus(Index n, const T* x, T* y);
template <class T>
void softplus_backward(Index n, const T* x, const T* g, bool accumulate, T* d);
template <class T>
void norm_sums(Index n, const T* x, T shift, double* sums);
template <class T>
void norm_apply(Index n, const T* x, const NormRow<T>& row, Activation activation, const T* base,
                T* y);
template <class T>
void norm_backward(Index n, const T* x, const T* g, const NormRow<T>& row, Activation activation,
                   bool accumulate, T* d, double* sums);
template <class T>
void norm_add_linear(Index n, const T* x, const NormRow<T>& row, T* d);
}  // namespace isa_avx512

}  // namespace satsurf

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/shape.h"

// Inner loops of elementwise.cpp, norm.cpp and softmax.cpp, declared once per instruction set
// (core/isa.h):
//   relu_backward    d += g where y > 0
//   gelu             y = x Phi(x)
//   gelu_backward    d += g (Phi(x) + x phi(x))
//   logistic         y = 1 / (1 + exp(-x))
//   norm_sums        sums[0] = sum(x - shift), sums[1] = sum((x - shift)^2)
//   norm_apply       y = act(scale x + offset)
//   norm_slopes      dz = g act'(z), z = gamma x_hat + beta, x_hat = rstd x + shift;
//                    sums[0] = sum(dz), sums[1] = sum(dz x_hat); dz is stored unless nullptr
//   norm_gradient    d += a dz + b x + c, dz as stored, or from g by the ReLU's mask (z > 0) or no
//                    activation
//   softmax          over D planes `stride` apart, n <= kSoftmaxTile pixels;
//                    tile [D kSoftmaxTile]
//   softmax_backward d += p (g - sum_k p_k g_k); tile [kSoftmaxTile]
// Sums are taken in lanes of T for short runs and in double between them, in a fixed order.

namespace satsurf {

enum class Activation;

/// Pixels worked on together: 64 hypotheses of them are half a first-level cache.
inline constexpr Index kSoftmaxTile = 64;

/// One row (b, c) of a group norm: x_hat = rstd x + shift, z = gamma x_hat + beta.
template <class T>
struct NormRow {
  T rstd, shift, gamma, beta;
};

namespace isa_baseline {
template <class T>
void relu_backward(Index n, const T* y, const T* g, T* d);
template <class T>
void gelu(Index n, const T* x, T* y);
template <class T>
void gelu_backward(Index n, const T* x, const T* g, T* d);
template <class T>
void logistic(Index n, const T* x, T* y);
template <class T>
void norm_sums(Index n, const T* x, T shift, double* sums);
template <class T>
void norm_apply(Index n, const T* x, const NormRow<T>& row, Activation activation, T* y);
template <class T>
void norm_slopes(Index n, const T* x, const T* g, const NormRow<T>& row, Activation activation,
                 T* dz, double* sums);
template <class T>
void norm_gradient(Index n, const T* x, const T* dz, const NormRow<T>& row, bool relu_mask, T a,
                   T b, T c, T* d);
template <class T>
void softmax(Index D, Index stride, Index n, const T* x, T* y, T* tile);
template <class T>
void softmax_backward(Index D, Index stride, Index n, const T* p, const T* g, T* d, T* tile);
}  // namespace isa_baseline

namespace isa_avx2 {
template <class T>
void relu_backward(Index n, const T* y, const T* g, T* d);
template <class T>
void gelu(Index n, const T* x, T* y);
template <class T>
void gelu_backward(Index n, const T* x, const T* g, T* d);
template <class T>
void logistic(Index n, const T* x, T* y);
template <class T>
void norm_sums(Index n, const T* x, T shift, double* sums);
template <class T>
void norm_apply(Index n, const T* x, const NormRow<T>& row, Activation activation, T* y);
template <class T>
void norm_slopes(Index n, const T* x, const T* g, const NormRow<T>& row, Activation activation,
                 T* dz, double* sums);
template <class T>
void norm_gradient(Index n, const T* x, const T* dz, const NormRow<T>& row, bool relu_mask, T a,
                   T b, T c, T* d);
template <class T>
void softmax(Index D, Index stride, Index n, const T* x, T* y, T* tile);
template <class T>
void softmax_backward(Index D, Index stride, Index n, const T* p, const T* g, T* d, T* tile);
}  // namespace isa_avx2

namespace isa_avx512 {
template <class T>
void relu_backward(Index n, const T* y, const T* g, T* d);
template <class T>
void gelu(Index n, const T* x, T* y);
template <class T>
void gelu_backward(Index n, const T* x, const T* g, T* d);
template <class T>
void logistic(Index n, const T* x, T* y);
template <class T>
void norm_sums(Index n, const T* x, T shift, double* sums);
template <class T>
void norm_apply(Index n, const T* x, const NormRow<T>& row, Activation activation, T* y);
template <class T>
void norm_slopes(Index n, const T* x, const T* g, const NormRow<T>& row, Activation activation,
                 T* dz, double* sums);
template <class T>
void norm_gradient(Index n, const T* x, const T* dz, const NormRow<T>& row, bool relu_mask, T a,
                   T b, T c, T* d);
template <class T>
void softmax(Index D, Index stride, Index n, const T* x, T* y, T* tile);
template <class T>
void softmax_backward(Index D, Index stride, Index n, const T* p, const T* g, T* d, T* tile);
}  // namespace isa_avx512

}  // namespace satsurf

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/shape.h"
#include "satsurf/ops/conv/kernels.h"
#include "satsurf/ops/normalised.h"

#include <array>

/// The three linear maps behind every convolution of ops/conv.h, on plain buffers. Internal to ops.
namespace satsurf::conv {

/// One 3D cross-correlation from `x` to `y`; 2D ones have a leading extent of 1. A transposed
/// convolution is the same object used from `y` to `x`.
struct Geometry {
  Index B = 1, C = 1, O = 1;                ///< images, channels of x, channels of y
  std::array<Index, 3> x_size{}, y_size{};  ///< depth, rows, columns
  std::array<Index, 3> kernel{}, stride{}, padding{};

  Index x_count() const { return x_size[0] * x_size[1] * x_size[2]; }
  Index y_count() const { return y_size[0] * y_size[1] * y_size[2]; }
  Index taps() const { return kernel[0] * kernel[1] * kernel[2]; }
};

/// What a convolution reads: x itself, or what ops/normalised.h makes of it on the way.
template <class T>
struct Input {
  const T* x;
  const T* affine = nullptr;  ///< [3 images channels], or nullptr
  Activation activation = Activation::none;

  bool plain() const { return affine == nullptr && activation == Activation::none; }
};

/// y[b,o,n] = bias[o] + sum_{c,t} weight[o,c,t] x[b,c,n*stride+t-padding]
/// x       [B C x_size]
/// weight  [O C kernel]
/// bias    [O], or nullptr
/// y       [B O y_size], added to if `accumulate`, overwritten otherwise
/// moments of y's channels [B O], or nullptr if nobody asks
template <class T>
void correlate(const ConvKernels<T>& kernels, const Geometry& geometry, const Input<T>& x,
               const T* weight, const T* bias, T* y, bool accumulate,
               ChannelMoments* moments = nullptr);

/// The adjoint of `correlate` in x:
///   x[b,c,n*stride+t-padding] = bias[c] + sum_{o,t} weight[o,c,t] y[b,o,n]
/// bias    [C], or nullptr
/// x       [B C x_size], added to if `accumulate`, overwritten otherwise
/// moments of x's channels [B C], or nullptr if nobody asks
template <class T>
void correlate_adjoint(const ConvKernels<T>& kernels, const Geometry& geometry, const Input<T>& y,
                       const T* weight, const T* bias, T* x, bool accumulate,
                       ChannelMoments* moments = nullptr);

/// The adjoint of `correlate` in the weight:
///   dw[o,c,t] += sum_{b,n} dy[b,o,n] x[b,c,n*stride+t-padding]
template <class T>
void correlate_weight_gradient(const ConvKernels<T>& kernels, const Geometry& geometry,
                               const Input<T>& x, const Input<T>& dy, T* dw);

/// db[c] += sum_{b,n} dy[b,c,n] over B images of C channels of N elements.
template <class T>
void bias_gradient(const ConvKernels<T>& kernels, Index B, Index C, Index N, const T* dy, T* db);

}  // namespace satsurf::conv

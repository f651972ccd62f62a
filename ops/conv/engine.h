// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/shape.h"
#include "satsurf/ops/conv/kernels.h"
#include "satsurf/ops/normalised.h"

#include <array>

/// The convolution engine: the linear maps behind every convolution of conv.h, on plain buffers.
/// Internal to ops.
///
/// Which operator needs which map (a 2D convolution is a 3D one with a leading extent of 1):
///
///   conv2d, conv3d     forward correlate,         x's gradient correlate_adjoint
///   conv_transpose3d   forward correlate_adjoint, x's gradient correlate
///   all three          weight's gradient correlate_weight_gradient, bias's gradient bias_gradient
///
/// The files, from the operators down to the vectors:
///
///   conv       operators: shapes, sizes, tape; picks the kernels of the active instruction set
///   gather     correlate and its adjoint, in which every output is a sum over channels and taps
///   gradient   the weight's gradient, a matrix product over positions, and the bias's
///   axes       how each axis of the input is split, which taps an output has, when rows are mixed
///   slab       the padded copy of the input laid out like that, and the pieces of work
///   weights    packing of the kernels, mixed where rows are
///   winograd   the mixing matrices
///   kernels    register tiles over a slab; they know neither strides nor padding nor rank
///   row_kernels  rows into a slab and out of it: padding, phases, normalisation, mixing
///
/// How data flow. Forward and x's gradient, per piece of output rows and planes: input rows are
/// normalised and padded or mixed into the slab, the register tiles make lines of sums of it, and
/// rows of the lines are joined or mixed back into the output. Weight's gradient, per block of
/// channels and stretch of pieces: x goes into a slab, dy into lines of the same layout, the tiles
/// add up their products in one vector per weight, and the vectors' lanes are summed at the end.
///
/// Layouts, the last index being contiguous:
///
///   slab            [channel][plane][row phase or mix][column phase][row][column of `pitch`]
///   packed weights  [block of outputs][phase][channel][tap][output of the block]
///   lines           [phase or mix][output of a block][position], position = row * pitch + column
///   weight sums     [mix][channel and tap][output of a block][lane]
///
/// Decisions, all from the sizes alone so that results do not depend on the number of threads:
///
///   path of the sums    correlation_route in gather.cpp: straight to the output where a kernel has
///                       one tap and rows are whole vectors; with channels in lanes where columns
///                       have stride 2, there are channels enough and the instruction set is fast at
///                       it, so that columns need not be split; through lines otherwise
///   mixing of rows      with_mixed_rows in axes.cpp: three taps, stride 1, and outputs enough to
///                       pay for mixing the kernels
///   rows of a piece     rows_in_cache and Pieces in slab.cpp: a slab fits the second-level cache
///                       and there are pieces enough to balance the threads
///   weight's gradient   the constants at the head of gradient.cpp: sums of a block of channels in
///                       the cache, blocks of dy in the first-level cache, partial sums of stretches
///                       added in order
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

/// What a map reads: x itself, or what ops/normalised.h makes of it on the way.
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
/// y_plane elements between the planes of y where these are rows of larger ones, 0 otherwise
template <class T>
void correlate(const ConvKernels<T>& kernels, const Geometry& geometry, const Input<T>& x,
               const T* weight, const T* bias, T* y, bool accumulate,
               ChannelMoments* moments = nullptr, Index y_plane = 0);

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

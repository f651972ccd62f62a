// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/shape.h"
#include "satsurf/ops/conv_row_kernels.h"

namespace satsurf {

/// Output channels whose weights stand next to each other in packed weights.
inline constexpr Index kConvBlock = 8;

/// A run of positions of one output plane and what each weight column reads beside it.
struct ConvSegment {
  const Index* columns;  ///< element of the slab that column q multiplies with position 0
  Index plane;           ///< element of the gradient's lines where position 0 stands
  Index first;           ///< first position
  Index vectors;         ///< number of vectors
};

/// Inner loops of the convolutions for one instruction set. They know nothing of strides, padding
/// or rank: the caller lays the input out such that position p of an output reads position p +
/// shift of a slab.
template <class T>
struct ConvKernels {
  Index lanes;                         ///< elements per vector
  Index column_group[kConvBlock + 1];  ///< weight columns per register tile, by number of outputs

  /// out[o][p] = sum_{c,t} weight[c][t][o] x[c * c_stride + shift[t] + p] for 0 <= p < n.
  /// Reads x and writes out up to n rounded up to whole vectors; weight is [C taps kConvBlock].
  void (*gather)(const T* x, Index c_stride, Index C, const Index* shift, Index taps,
                 const T* weight, Index outputs, Index n, T* out, Index out_stride);

  /// partial[q][o][lane] += sum_positions g[o * g_stride + plane + position]
  ///   x[columns[q] + position], for the segments one after another; q < groups *
  /// column_group[outputs]. Lines of g begin at whole vectors, and so do segments.
  void (*weight_gradient)(const T* x, const ConvSegment* segments, Index count, const T* g,
                          Index g_stride, Index outputs, Index groups, T* partial);

  /// out[i] = sum of the lanes of vector i of `vectors`
  void (*sum_lanes)(const T* vectors, Index n, T* out);

  /// Sum of n elements in a fixed order.
  T (*sum)(const T* x, Index n);

  ConvRowKernels<T> rows;
};

namespace isa_baseline {
template <class T>
const ConvKernels<T>& conv_kernels();
}
namespace isa_avx2 {
template <class T>
const ConvKernels<T>& conv_kernels();
}
namespace isa_avx512 {
template <class T>
const ConvKernels<T>& conv_kernels();
}

}  // namespace satsurf

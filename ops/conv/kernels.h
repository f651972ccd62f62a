// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/isa.h"
#include "satsurf/core/shape.h"
#include "satsurf/ops/conv/row_kernels.h"

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

/// A sum over input channels and taps for some outputs:
///   sum[o][p] = bias[o] + sum_{c,t} weight[c][t][o] x[c * c_stride + shift[t] + p]
template <class T>
struct ConvGather {
  const T* x;
  Index c_stride, C;
  const Index* shift;
  Index taps;
  const T* weight;  ///< [C taps block]
  const T* bias;    ///< [block]
  bool add;         ///< to what is there, instead of overwriting it
  Index outputs;    ///< at most block
  T* out;           ///< sum[o][p] goes to out[o * out_stride + p]
  Index out_stride;
};

/// Inner loops of the convolutions for one instruction set. They know nothing of strides, padding
/// or rank: the caller lays the input out such that position p of an output reads position p +
/// shift of a slab.
template <class T>
struct ConvKernels {
  Index lanes;                         ///< elements per vector
  Index column_group[kConvBlock + 1];  ///< weight columns per register tile, by number of outputs
  /// Whether gather_in_lanes is the faster where columns have stride 2. One weight and a position per
  /// multiply-add come from memory, so it pays where those keep up with the multiply-adds.
  bool keeps_channels_in_lanes;

  /// Positions 0 <= p < n, in blocks of kConvBlock outputs. Reads x and writes out up to n rounded
  /// up to whole vectors.
  void (*gather)(const ConvGather<T>& gather, Index n);

  /// Positions 0, step, 2 step, .. of which there are n, which go to out[o * out_stride + p / step],
  /// in blocks of `lanes` outputs, which stand in the lanes. step is 1 or 2. Touches nothing else.
  void (*gather_in_lanes)(const ConvGather<T>& gather, Index n, Index step);

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

  template <Isa isa>
  static ConvKernels compiled_for();
};

}  // namespace satsurf

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/isa.h"
#include "satsurf/ops/normalised.h"
#include "satsurf/ops/pointwise_kernels.h"

namespace satsurf {

/// How the convolutions move rows into and out of their working layout, for one instruction set.
/// Part of ConvKernels.
template <class T>
struct ConvRowKernels {
  /// dst[f * phase_stride + i] = src[i * phases + f - left] where that index is in [0, n), else 0,
  /// for every phase f and 0 <= i < count
  void (*pad)(const T* src, Index n, Index left, Index phases, T* dst, Index phase_stride,
              Index count);

  /// dst[m * phases + f] = (accumulate ? itself : 0) + bias + src[f * phase_stride + m], below n
  void (*store)(const T* src, Index phase_stride, Index phases, T bias, bool accumulate, T* dst,
                Index n);

  /// dst[p] = the normalised src[p], 0 <= p < n, as norm_apply in pointwise_kernels.h
  void (*normalise)(Index n, const T* src, const NormRow<T>& row, Activation activation,
                    const T* base, T* dst);
  /// sums[0] = sum(x - shift), sums[1] = sum((x - shift)^2), as norm_sums there
  void (*sums)(Index n, const T* x, T shift, double* sums);

  // The three maps of F(4, 3), see winograd.h, from row to row. Mix i of what `src` points to
  // or of what goes to dst stands at i * mix_stride.

  /// dst[left + p] = B applied to the six rows src[.][p], 0 <= p < n; zero in front and behind, up
  /// to count
  void (*mix_input)(const T* const* src, Index n, Index left, T* dst, Index mix_stride,
                    Index count);
  /// dst[j * dst_stride + p] = (accumulate ? itself : 0) + bias + A applied to the mixes, for the
  /// first `rows` of the four outputs j and 0 <= p < n
  void (*mix_output)(const T* src, Index mix_stride, T bias, bool accumulate, T* dst,
                     Index dst_stride, Index rows, Index n);
  /// dst[p] = the adjoint of A applied to the four rows src[.][p], 0 <= p < n; zero behind, up to
  /// count
  void (*mix_gradient)(const T* const* src, Index n, T* dst, Index mix_stride, Index count);

  template <Isa isa>
  static ConvRowKernels compiled_for();
};

}  // namespace satsurf

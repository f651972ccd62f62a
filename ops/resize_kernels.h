// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/isa.h"
#include "satsurf/core/shape.h"

namespace satsurf {

/// The loops of resize.cpp along one row, for one instruction set.
template <class T>
struct ResizeKernels {
  /// y[i] = sum_r weight[r] rows[r][i], 0 <= i < n
  void (*mix)(Index count, const T* const* rows, const T* weight, Index n, T* y);
  /// y[i] = a[i] + weight (b[i] - a[i])
  void (*between)(Index n, const T* a, const T* b, T weight, T* y);
  /// d[i] = scale x[i]; with `accumulate`, here and below, that is added
  void (*scaled)(Index n, const T* x, T scale, bool accumulate, T* d);

  // To twice the width and back; n elements on the narrow side.

  /// y[2 i] = y[2 i + 1] = x[i]
  void (*repeat)(Index n, const T* x, T* y);
  /// y[i] = scale (x[2 i] + x[2 i + 1])
  void (*pair_sums)(Index n, const T* x, T scale, bool accumulate, T* y);
  /// y[2 i] = (3 x[i] + x[i - 1]) / 4, y[2 i + 1] = (3 x[i] + x[i + 1]) / 4; reads x[-1] and x[n]
  void (*expand)(Index n, const T* x, T* y);
  /// The adjoint: d[i] = (3 (g[2 i] + g[2 i + 1]) + g[2 i - 1] + g[2 i + 2]) / 4; reads g[-1] and
  /// g[2 n]
  void (*expand_backward)(Index n, const T* g, bool accumulate, T* d);

  template <Isa isa>
  static ResizeKernels compiled_for();
};

}  // namespace satsurf

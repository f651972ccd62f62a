// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/shape.h"

namespace satsurf {

/// The loop of pixels_from_map in concat.cpp, for one instruction set.
template <class T>
struct LayoutKernels {
  /// y[j y_stride + i] = x[i x_stride + j], or += with `accumulate`, 0 <= i < rows,
  /// 0 <= j < columns
  void (*transpose)(Index rows, Index columns, const T* x, Index x_stride, bool accumulate, T* y,
                    Index y_stride);
};

namespace isa_baseline {
template <class T>
LayoutKernels<T> layout_kernels();
}
namespace isa_avx2 {
template <class T>
LayoutKernels<T> layout_kernels();
}
namespace isa_avx512 {
template <class T>
LayoutKernels<T> layout_kernels();
}

}  // namespace satsurf

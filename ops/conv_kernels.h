// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/shape.h"

namespace satsurf {

/// Inner loops of the convolutions for one instruction set.
template <class T>
struct ConvKernels {
  /// Sum of n elements in a fixed order.
  T (*sum)(const T* x, Index n);
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

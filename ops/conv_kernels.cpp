// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/conv_kernels.h"

#include "satsurf/core/simd.h"

namespace satsurf::SATSURF_ISA_NS {
namespace {

template <class T>
T sum(const T* x, Index n) {
  constexpr Index L = kLanes<T>;
  Batch<T> a(T(0)), b(T(0)), c(T(0)), d(T(0));
  Index i = 0;
  for (; i + 4 * L <= n; i += 4 * L) {
    a += Batch<T>::load_unaligned(x + i);
    b += Batch<T>::load_unaligned(x + i + L);
    c += Batch<T>::load_unaligned(x + i + 2 * L);
    d += Batch<T>::load_unaligned(x + i + 3 * L);
  }
  T lanes[kLanes<T>];
  ((a + b) + (c + d)).store_unaligned(lanes);
  T total = 0;
  for (Index l = 0; l < L; ++l) total += lanes[l];
  for (; i < n; ++i) total += x[i];
  return total;
}

}  // namespace

template <class T>
const ConvKernels<T>& conv_kernels() {
  static constexpr ConvKernels<T> kernels{.sum = sum<T>};
  return kernels;
}
template const ConvKernels<float>& conv_kernels();
template const ConvKernels<double>& conv_kernels();

}  // namespace satsurf::SATSURF_ISA_NS

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/layout_kernels.h"

#include "satsurf/core/simd.h"

#include <cstddef>

namespace satsurf::SATSURF_ISA_NS {
namespace {

/// A square of as many rows as a vector has elements.
template <class T, std::size_t Bytes>
struct Square {
  using P = Part<T, Bytes>;
  static constexpr Index K = P::kCount;
  typename P::Vector row[K];

  /// Turns the address of every element, row K + lane, left by one bit.
  template <Index... I>
  void rotate(Lanes<I...>) {
    typename P::Vector next[K];
#pragma GCC unroll 16
    for (Index r = 0; r < K / 2; ++r) {
      next[2 * r] = __builtin_shufflevector(row[r], row[r + K / 2], (I / 2 + I % 2 * K)...);
      next[2 * r + 1] =
          __builtin_shufflevector(row[r], row[r + K / 2], (I / 2 + K / 2 + I % 2 * K)...);
    }
#pragma GCC unroll 16
    for (Index r = 0; r < K; ++r) row[r] = next[r];
  }
  /// Turning by half the bits exchanges row and lane.
  void transpose() {
#pragma GCC unroll 4
    for (Index k = 1; k < K; k *= 2) rotate(typename P::Indices{});
  }
};

template <class T, std::size_t Bytes = kVectorBytes<T>>
void transpose(Index rows, Index columns, const T* x, Index x_stride, bool accumulate, T* y,
               Index y_stride) {
  if constexpr (Bytes < 16) {
    for (Index i = 0; i < rows; ++i)
      for (Index j = 0; j < columns; ++j) {
        T* to = y + j * y_stride + i;
        *to = (accumulate ? *to : T(0)) + x[i * x_stride + j];
      }
  } else {
    using P = Part<T, Bytes>;
    constexpr Index K = P::kCount;
    const auto square = [=](Index i, Index j) {
      Square<T, Bytes> s;
#pragma GCC unroll 16
      for (Index r = 0; r < K; ++r) s.row[r] = P::load(x + (i + r) * x_stride + j);
      s.transpose();
#pragma GCC unroll 16
      for (Index r = 0; r < K; ++r) {
        T* to = y + (j + r) * y_stride + i;
        P::store(to, accumulate ? P::load(to) + s.row[r] : s.row[r]);
      }
    };
    const Index whole_rows = rows / K * K, whole_columns = columns / K * K;
    if (rows < columns) {  // the long side inside: long streams
      for (Index i = 0; i < whole_rows; i += K)
        for (Index j = 0; j < whole_columns; j += K) square(i, j);
    } else {
      for (Index j = 0; j < whole_columns; j += K)
        for (Index i = 0; i < whole_rows; i += K) square(i, j);
    }
    transpose<T, Bytes / 2>(rows, columns - whole_columns, x + whole_columns, x_stride, accumulate,
                            y + whole_columns * y_stride, y_stride);
    transpose<T, Bytes / 2>(rows - whole_rows, whole_columns, x + whole_rows * x_stride, x_stride,
                            accumulate, y + whole_rows, y_stride);
  }
}

}  // namespace

template <class T>
LayoutKernels<T> layout_kernels() {
  return {.transpose = transpose<T>};
}
template LayoutKernels<float> layout_kernels();
template LayoutKernels<double> layout_kernels();

}  // namespace satsurf::SATSURF_ISA_NS

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/isa.h"
#include "satsurf/core/shape.h"

namespace satsurf {

/// The window of ssim.cpp: kSsimRadius pixels to either side of its centre.
inline constexpr Index kSsimRadius = 5, kSsimWindow = 2 * kSsimRadius + 1;
/// Elements that must be readable on either side of what `compare` and `gather` are told to filter
/// across: the radius behind, the radius and a vector ahead.
inline constexpr Index kSsimSlack = kSsimRadius + 16;

/// Numbers of the similarity's formula.
template <class T>
struct SsimTerms {
  T window[kSsimRadius + 1];  ///< weights by distance from the centre; all eleven sum to 1
  T covariance;               ///< factor of variances and covariance
  T c1, c2;
};

/// The loops of ssim.cpp for one instruction set. Eleven rows are one window high.
template <class T>
struct SsimKernels {
  /// Filters x, y, x^2, y^2 and x y down the columns of eleven rows each.
  void (*moments)(const SsimTerms<T>& terms, const T* const* x, const T* const* y, Index n,
                  T* const* filtered);
  /// Filters those five across and compares; pixels of 0 in `counts` do not count.
  /// slopes  nullptr, or three rows that take the similarity's derivatives by the filtered x, x^2
  ///         and x y; 0 where a pixel does not count
  /// sums    takes the sum of the similarities and the number of pixels that count
  void (*compare)(const SsimTerms<T>& terms, const T* const* filtered, const T* counts, Index n,
                  T* const* slopes, double* sums);
  /// Filters one map down its columns.
  void (*down)(const SsimTerms<T>& terms, const T* const* rows, Index n, T* filtered);
  /// Filters three maps of slopes across and adds the gradient where `counts` is not 0:
  ///   d += factor (F0 + 2 x F1 + y F2)
  void (*gather)(const SsimTerms<T>& terms, const T* const* filtered, const T* x, const T* y,
                 const T* counts, T factor, Index n, T* d);

  template <Isa isa>
  static SsimKernels compiled_for();
};

}  // namespace satsurf

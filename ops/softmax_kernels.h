// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/isa.h"
#include "satsurf/core/shape.h"

namespace satsurf {

/// Pixels worked on together: rows of 2 kB, long enough for the processor to fetch ahead, of which
/// 64 hypotheses are an eighth of a second-level cache.
inline constexpr Index kSoftmaxPixels = 512;
/// From row to row of a tile. Not a power of two: loads and stores whose addresses agree in the
/// last 12 bits wait for each other.
inline constexpr Index kSoftmaxRow = kSoftmaxPixels + 16;

/// What the backward pass reads and writes, for D planes `stride` apart from the first pixel on.
template <class T>
struct SoftmaxGradient {
  const T* p = nullptr;
  const T* g = nullptr;  ///< of p; nullptr for none
  const T* z = nullptr;  ///< heights; nullptr if there are none of the next four, one plane each
  const T *height = nullptr, *confidence = nullptr;
  const T *g_height = nullptr, *g_confidence = nullptr;
  T* d = nullptr;
  bool accumulate = true;  ///< d_d += instead of d_d =
};

/// The loops of softmax.cpp over D planes `stride` apart and n pixels, at most kSoftmaxPixels where
/// there is a tile, for one instruction set.
template <class T>
struct SoftmaxKernels {
  /// y_d = exp(x_d) / sum_k exp(x_k); unless z is nullptr also
  /// height = sum_d y_d z_d, confidence = max_d y_d
  /// tile  [(D + 3) kSoftmaxRow]
  void (*forward)(Index D, Index stride, Index n, const T* x, const T* z, T* y, T* height,
                  T* confidence, T* tile);
  /// d_d = p_d (g_d - sum_k p_k g_k); with z, g_height (z_d - height) is added inside the bracket
  /// and g_d is larger by g_confidence at the first maximum
  /// tile  [2 kSoftmaxRow]
  void (*backward)(Index D, Index stride, Index n, const SoftmaxGradient<T>& of, T* tile);

  template <Isa isa>
  static SoftmaxKernels compiled_for();
};

}  // namespace satsurf

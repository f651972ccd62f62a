// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/isa.h"
#include "satsurf/core/shape.h"
#include "satsurf/ops/window_correlation.h"

// The loops of one row, for window_correlation.cpp alone.

namespace satsurf {

/// What is summed over a window, where both images count: 1, a, b, a a, b b, a b.
inline constexpr Index kWindowSums = 6;
/// Rows of a window.
inline constexpr Index kWindowSide = 2 * ComparedWindow::kRadius + 1;

/// One row of an image, and where it lies in another.
template <class T>
struct WarpedRow {
  Index n;               ///< pixels
  const T *a, *a_valid;  ///< [n]
  Index H, W;            ///< of the other image
  const T *b, *b_valid;  ///< [H W]
  double t0, step;       ///< of pixel i, t = t0 + i step
  double u[3], v[3];     ///< column, row = u[0] + t (u[1] + t u[2]), likewise v
};

/// The loops of window_correlation.cpp for one instruction set.
template <class T>
struct WindowCorrelationKernels {
  /// The summands of each pixel, 0 where it does not count.
  /// out      [kWindowSums n]
  /// returns  pixels that count
  Index (*products)(const WarpedRow<T>& row, T* out);
  /// The correlation in the windows around the pixels of a row.
  /// rows     [kWindowSide] -> [kWindowSums n], the rows of the windows
  /// columns  scratch [n + 2 kRadius]; the first and last kRadius are 0 and stay so
  /// sums     scratch [kWindowSums n]
  /// out      [n] -1 where too little counts or a window is flat
  void (*correlate)(const T* const* rows, Index n, T* columns, T* sums, T* out);
  /// See `window_products`.
  void (*window_products)(const T* weights, Index side, const T* image, Index stride, Index count,
                          T* out);

  template <Isa isa>
  static WindowCorrelationKernels compiled_for();
};

}  // namespace satsurf

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/isa.h"
#include "satsurf/core/shape.h"

namespace satsurf {

/// What a loss makes of an error e.
enum class Distance {
  squared,   ///< e^2
  smooth_l1  ///< e^2 / (2 beta) for |e| < beta, else |e| - beta / 2
};

/// The loops of loss.cpp for one instruction set. Elements of weight 0 count as error 0, whatever x
/// and target are; weight may be nullptr for ones.
template <class T>
struct LossKernels {
  /// sums[0] = sum(w distance(x - target)), sums[1] = sum(w); in lanes of T for short runs and in
  /// double between them, in a fixed order
  void (*sums)(Distance distance, T beta, Index n, const T* x, const T* target, const T* weight,
               double* sums);
  /// d += factor w distance'(x - target)
  void (*backward)(Distance distance, T beta, T factor, Index n, const T* x, const T* target,
                   const T* weight, T* d);

  template <Isa isa>
  static LossKernels compiled_for();
};

}  // namespace satsurf

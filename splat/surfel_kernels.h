// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/isa.h"
#include "satsurf/splat/rasterize_kernels.h"

namespace satsurf::splat {

/// Surfels seen closer to edge-on than this are left out, px^2.
inline constexpr double kDetMin = 1e-8;

/// The tensors of BasicSurfels and BasicProjection as plain pointers.
template <class T>
struct SurfelArrays {
  const T *means, *quats, *scales, *opacity, *colours, *aux, *pixels, *jacobians;
  Index aux_channels;  ///< K
};
/// Where to add gradients; nullptr where nobody wants them.
template <class T>
struct SurfelGradients {
  T *means, *quats, *scales, *opacity, *colours, *aux;
};

/// The passes over surfels begin..end-1, before and after those over tiles, for one instruction set.
template <class T>
struct SurfelKernels {
  /// Fills their records and boxes.
  void (*prepare)(const SurfelArrays<T>& in, Index height, Index width, bool smooth, Index begin,
                  Index end, T* records, Box* boxes);
  /// Sums their slots in order and adds their gradients.
  void (*gather)(const SurfelArrays<T>& in, const Index* first_slot, const T* slots, Index begin,
                 Index end, const SurfelGradients<T>& out);

  template <Isa isa>
  static SurfelKernels compiled_for();
};

}  // namespace satsurf::splat

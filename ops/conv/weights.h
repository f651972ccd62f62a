// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/tensor.h"
#include "satsurf/ops/conv/axes.h"

#include <array>
#include <vector>

/// Kernels in the order in which `ConvKernels::gather` reads them. Internal to ops/conv.
namespace satsurf::conv {

/// One output phase of each axis, and the kernel's positions that reach it.
struct PhaseTaps {
  const AxisPhase *z, *y, *x;
  Index first_row;          ///< first output row of the phase
  std::vector<Index> taps;  ///< positions in the kernel, or in the mixed one of six rows
  Index taps_before;        ///< number of taps of the phases in front of this one
};

/// Depth, row and column phases nested in this order.
/// kernel  of `kernel_of`
std::vector<PhaseTaps> list_phases(const Axes& axes, const std::array<Index, 3>& kernel);

/// How the weights of O outputs that gather from C channels are stored, and are to be packed.
struct WeightLayout {
  Index O, C;
  Index o_stride, c_stride;  ///< between kernels of neighbouring outputs and channels, in kernels
  Index block;               ///< outputs whose weights stand next to each other when packed
};

/// [block of outputs][phase][channel][tap][output of the block], outputs beyond O being zero. Where
/// rows are mixed, the kernels are G applied to those that came.
template <class T>
BasicTensor<T> packed_weights(const Geometry& g, const Axes& axes,
                              const std::vector<PhaseTaps>& phases, const WeightLayout& layout,
                              const T* weight);

}  // namespace satsurf::conv

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/ops/conv/engine.h"

#include <array>
#include <vector>

/// Where the convolution engine puts its input, so that strides and padding vanish from the inner
/// loops. Internal to ops/conv.
///
/// A slab (slab.h) is a zero-padded copy of some rows of every channel of an image. Along each axis
/// the input is split into `input_phases` interleaved phases, in a correlation as many as the stride,
/// so that what neighbouring outputs read is contiguous. Rows stand `pitch` elements apart: output (m_row,
/// m_column) is position m_row * pitch + m_column and reads position + shift, with one shift per
/// tap. Outputs whose stride exceeds 1, those of the adjoint of a strided correlation, are split
/// into phases as well, each with its own taps.
///
/// Rows of stride 1 and three taps can be mixed instead, as Winograd's minimal filtering F(4, 3) of
/// winograd.h has it: six combinations of the input's rows 4 m .. 4 m + 5 take the place of the
/// phases, each with one tap of its own, and the four output rows are combinations of the six
/// results. That halves the multiplications and leaves columns, planes and channels as they are.
namespace satsurf::conv {

/// One tap of one output phase along one axis.
struct AxisTap {
  Index tap;    ///< position in the kernel
  Index phase;  ///< of the input
  Index shift;  ///< index within that phase, relative to the output's
};

/// The outputs n = phase + m * (number of phases) along one axis.
struct AxisPhase {
  Index count = 0;  ///< of outputs
  std::vector<AxisTap> taps;
};

struct Axis {
  Index size = 0;  ///< of the input
  /// Index i of phase f in the slab holds input i * input_phases + f - left, or 0 outside.
  Index input_phases = 1, left = 0;
  bool mixed = false;  ///< phases are F(4, 3)'s; index i of each mixes inputs from 4 i - left on
  Index max_shift = 0;
  Index most_outputs = 0;  ///< of the largest phase
  std::vector<AxisPhase> phases;
  std::array<Index, 3> kernel_order{};  ///< of a mixed axis: kernel positions by shift

  /// Consecutive unsplit slab indices that one output of every phase reads.
  Index span() const { return (max_shift + 1) * input_phases; }
};

using Axes = std::array<Axis, 3>;

/// Layouts of a correlation (input x) and of its adjoint (input y).
Axes correlation_axes(const Geometry& g);
Axes adjoint_axes(const Geometry& g);

/// The same with rows mixed as F(4, 3) has it where that saves work, else as they are.
/// B  images; mixing the kernels has to pay for itself
Axes with_mixed_rows(Axes axes, Index B);

/// The same with unsplit columns, for outputs that read every `stride` elements of a row.
Axes with_whole_columns(Axes axes, const Geometry& g);

/// Smallest row pitch: the zeros behind a row may serve as those in front of the next.
Index row_pitch(const Axis& columns);

/// Extents of the kernel as the slab's phases have it: mixed rows have six taps.
std::array<Index, 3> kernel_of(const Axes& axes, const Geometry& g);

inline Index ceil_div(Index a, Index b) { return (a + b - 1) / b; }

}  // namespace satsurf::conv

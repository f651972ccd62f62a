// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/tensor.h"
#include "satsurf/ops/conv/axes.h"

/// The convolution engine's copy of its input, laid out as axes.h has it, and the pieces of work
/// that each have a slab of their own. Internal to ops/conv.
namespace satsurf::conv {

/// Rows of an input as a convolution is to see them: where they are, or normalised in a line of
/// their own.
template <class T>
class Rows {
 public:
  /// channels  of all images together
  /// size      of a row
  /// lines     normalised rows that are there at the same time
  Rows(const ConvKernels<T>& kernels, const Input<T>& input, Index channels, Index size,
       Index lines);
  const T* input() const { return input_.x; }
  /// Whether `read` copies.
  bool copies() const { return !input_.plain(); }
  /// The row at `src` of one channel (numbered through all images), in line number `line`.
  const T* read(const T* src, Index channel, Index line);

 private:
  const ConvKernels<T>& kernels_;
  const Input<T> input_;
  const NormRows<T> norm_;
  const Index size_;
  BasicTensor<T> lines_;
};

/// A ring of padded planes of C channels. Moving on by one output plane loads only what is new.
template <class T>
class Slab {
 public:
  /// input     whose channels are taken
  /// channels  of all its images together
  /// C         that the slab holds
  /// rows      output rows (of the largest phase) that the planes serve
  /// planes    in the ring
  Slab(const ConvKernels<T>& kernels, const Axes& axes, const Input<T>& input, Index channels,
       Index C, Index rows, Index planes);

  static Index bytes(const Axes& axes, Index C, Index rows, Index planes);

  /// Starts on the outputs from `row` on of the channels from `channel` on, numbered through all
  /// images; the ring is empty.
  void start(Index channel, Index row);
  /// Fills the ring with the padded planes [first, last).
  void load(Index first, Index last);

  const T* data() const { return buffer_.data(); }
  Index c_stride() const { return c_stride_; }
  Index pitch() const { return pitch_; }
  /// Shift of one tap for the output plane m of any phase.
  Index shift(Index m, const AxisTap& z, const AxisTap& y, const AxisTap& x) const;

 private:
  void load_plane(Index plane);
  /// src   the channel's plane, nullptr outside the image
  /// next  a plane that is loaded later, or nullptr
  void load_rows(const T* src, const T* next, Index channel, T* dst);
  void load_mixed_rows(const T* src, const T* next, Index channel, T* dst);

  const ConvKernels<T>& kernels_;
  const Axes& axes_;
  Index C_, planes_, pitch_, line_rows_, plane_stride_, c_stride_;
  BasicTensor<T> buffer_, zeros_;
  Rows<T> rows_;
  Index channel_ = 0, row_ = 0, next_ = 0;
};

/// One stretch of work: output rows [row, row + rows) of output planes [z, z_end) of image b,
/// counted in the largest phase.
struct Piece {
  Index b, row, rows, z, z_end;
};

/// Cuts the outputs of B images into pieces, from the sizes alone.
class Pieces {
 public:
  /// most_rows  per piece, so that its slab stays in the cache
  /// wanted     pieces to balance the load, as long as they do not get too small
  Pieces(Index B, const Axes& axes, Index most_rows, Index wanted);

  Index count() const { return B_ * chunks_ * z_blocks_; }
  Index rows() const { return rows_; }
  Piece operator[](Index i) const;

 private:
  Index B_, D_, H_, rows_, chunks_, z_size_, z_blocks_;
};

/// An odd number of cache lines: strides near a multiple of 4 KiB would put all planes in the same
/// sets.
template <class T>
Index odd_lines(Index elements) {
  constexpr Index kLine = 64 / static_cast<Index>(sizeof(T));
  const Index lines = (elements + kLine - 1) / kLine;
  return (lines | 1) * kLine;
}

/// Asks for the elements [begin, end) ahead of their use.
template <class T>
void prefetch(const T* begin, const T* end) {
  constexpr Index kLine = 64 / static_cast<Index>(sizeof(T));
  for (const T* p = begin; p < end; p += kLine) {
    __builtin_prefetch(p, 0, 2);
    asm volatile("");  // g++ drops calls of functions that do nothing but prefetch
  }
}

/// Most output rows of which a slab of that many planes fits the cache.
template <class T>
Index rows_in_cache(const Axes& axes, Index C, Index planes);

}  // namespace satsurf::conv

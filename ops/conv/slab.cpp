// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/conv/slab.h"

#include "satsurf/ops/conv/winograd.h"

#include <algorithm>

namespace satsurf::conv {
namespace {

constexpr Index kSlabBytes = 640 << 10;  // leaves room for outputs and weights in a 1 MiB cache
constexpr Index kMinRows = 4;            // below this the rows read twice outweigh the balance

/// Zeros behind the last row of a plane stand in for the row that would follow.
template <class T>
Index plane_stride(const Axes& axes, Index rows) {
  const Index pitch = row_pitch(axes[2]),
              borrowed = axes[2].most_outputs + axes[2].max_shift - pitch;
  const Index lines = axes[1].input_phases * axes[2].input_phases * (rows + axes[1].max_shift);
  return odd_lines<T>(lines * pitch + borrowed);
}

/// Whole vectors are read, beyond the last output's columns.
template <class T>
Index tail(const Axes& axes) {
  return axes[2].most_outputs + axes[2].max_shift + 2 * 64 / static_cast<Index>(sizeof(T));
}

}  // namespace

template <class T>
Rows<T>::Rows(const ConvKernels<T>& kernels, const Input<T>& input, Index channels, Index size,
              Index lines)
    : kernels_(kernels),
      input_(input),
      norm_(input.affine, channels),
      size_(size),
      lines_(BasicTensor<T>::uninitialised({copies() ? lines : 0, size})) {}

template <class T>
const T* Rows<T>::read(const T* src, Index channel, Index line) {
  if (!copies()) return src;
  T* dst = lines_.data() + line * size_;
  kernels_.rows.normalise(size_, src, norm_[channel], input_.activation, nullptr, dst);
  return dst;
}

template <class T>
Slab<T>::Slab(const ConvKernels<T>& kernels, const Axes& axes, const Input<T>& input,
              Index channels, Index C, Index rows, Index planes)
    : kernels_(kernels),
      axes_(axes),
      C_(C),
      planes_(planes),
      pitch_(row_pitch(axes[2])),
      line_rows_(rows + axes[1].max_shift),
      plane_stride_(plane_stride<T>(axes, rows)),
      c_stride_(odd_lines<T>(planes * plane_stride_)),
      buffer_(BasicTensor<T>::uninitialised({C * c_stride_ + tail<T>(axes)})),
      zeros_(BasicTensor<T>({axes[1].mixed ? axes[2].size : 0})),
      rows_(kernels, input, channels, axes[2].size, winograd::kMixes) {
  // What lies between planes may serve as a row's trailing zeros; everything else load_plane
  // writes. Whole vectors at the end of a plane reach into the next, which may not be loaded yet:
  // what they read there must be finite, for it meets zeros of the other factor.
  const Index used = axes[1].input_phases * axes[2].input_phases * line_rows_ * pitch_;
  for (Index c = 0; c < C_; ++c) {
    T* channel = buffer_.data() + c * c_stride_;
    for (Index i = 0; i < planes_; ++i) {
      T* plane = channel + i * plane_stride_;
      std::fill(plane, plane + std::min(tail<T>(axes), used), T(0));
      std::fill(plane + used, plane + plane_stride_, T(0));
    }
    std::fill(channel + planes_ * plane_stride_, channel + c_stride_, T(0));
  }
  std::fill(buffer_.data() + C_ * c_stride_, buffer_.data() + buffer_.count(), T(0));
}

template <class T>
Index Slab<T>::bytes(const Axes& axes, Index C, Index rows, Index planes) {
  return C * planes * plane_stride<T>(axes, rows) * static_cast<Index>(sizeof(T));
}

template <class T>
void Slab<T>::start(Index channel, Index row) {
  channel_ = channel;
  row_ = row;
  next_ = 0;
}

template <class T>
void Slab<T>::load(Index first, Index last) {
  for (next_ = std::max(next_, first); next_ < last; ++next_) load_plane(next_);
}

template <class T>
void Slab<T>::load_plane(Index plane) {
  const Axis &depth = axes_[0], &row = axes_[1], &column = axes_[2];
  const Index z = plane - depth.left, plane_count = row.size * column.size;
  // Planes lie too far apart for the processor to guess the next one, and their rows are soon over.
  // What the next depth needs arrives while this one is computed.
  const auto plane_of = [&](Index c, Index at) -> const T* {
    const bool inside = c < channel_ + C_ && at >= 0 && at < depth.size;
    return inside ? rows_.input() + (c * depth.size + at) * plane_count : nullptr;
  };
  T* dst = buffer_.data() + plane % planes_ * plane_stride_;
  for (Index c = channel_; c < channel_ + C_; ++c, dst += c_stride_) {
    const T *src = plane_of(c, z), *next = plane_of(c, z + 1);
    if (next == nullptr) next = plane_of(c + 1, z);
    if (row.mixed)
      load_mixed_rows(src, next, c, dst);
    else
      load_rows(src, next, c, dst);
  }
}

template <class T>
void Slab<T>::load_rows(const T* src, const T* next, Index channel, T* dst) {
  const Axis &row = axes_[1], &column = axes_[2];
  for (Index f = 0; f < row.input_phases; ++f, dst += column.input_phases * line_rows_ * pitch_)
    for (Index i = 0; i < line_rows_; ++i) {
      const Index y = (row_ + i) * row.input_phases + f - row.left;
      const bool inside = src != nullptr && y >= 0 && y < row.size;
      if (next != nullptr && y >= 0 && y < row.size)
        prefetch(next + y * column.size, next + (y + 1) * column.size);
      kernels_.rows.pad(inside ? rows_.read(src + y * column.size, channel, 0) : nullptr,
                        inside ? column.size : 0, column.left, column.input_phases,
                        dst + i * pitch_, line_rows_ * pitch_, pitch_);
    }
}

template <class T>
void Slab<T>::load_mixed_rows(const T* src, const T* next, Index channel, T* dst) {
  using namespace winograd;
  const Axis &row = axes_[1], &column = axes_[2];
  std::array<const T*, kMixes> lines{};  // by row modulo kMixes: groups of six share two
  Index known = -1;                      // last row that has been read
  for (Index i = 0; i < line_rows_; ++i) {
    std::array<const T*, kMixes> rows;
    for (Index k = 0; k < kMixes; ++k) {
      const Index y = (row_ + i) * kOutputs + k - row.left;
      const T*& at = rows[k];
      if (src == nullptr || y < 0 || y >= row.size) {
        at = zeros_.data();
      } else if (y <= known) {
        at = lines[y % kMixes];
      } else {
        at = rows_.read(src + y * column.size, channel, y % kMixes);
        lines[y % kMixes] = at;
        known = y;
      }
    }
    if (next != nullptr) {
      const Index first = (row_ + i) * kOutputs - row.left, fresh = i == 0 ? 0 : kMixes - kOutputs;
      prefetch(next + std::max<Index>(0, first + fresh) * column.size,
               next + std::min(row.size, first + kMixes) * column.size);
    }
    kernels_.rows.mix_input(rows.data(), column.size, column.left, dst + i * pitch_,
                            line_rows_ * pitch_, pitch_);
  }
}

template <class T>
Index Slab<T>::shift(Index m, const AxisTap& z, const AxisTap& y, const AxisTap& x) const {
  const Index plane = (m + z.shift) * axes_[0].input_phases + z.phase;
  const Index line = (y.phase * axes_[2].input_phases + x.phase) * line_rows_ + y.shift;
  return plane % planes_ * plane_stride_ + line * pitch_ + x.shift;
}

Pieces::Pieces(Index B, const Axes& axes, Index most_rows, Index wanted)
    : B_(B),
      D_(std::max<Index>(1, axes[0].most_outputs)),
      H_(std::max<Index>(1, axes[1].most_outputs)) {
  rows_ = std::clamp<Index>(most_rows, 1, H_);
  // Planes first: cutting between them costs little as long as two or more stay together.
  z_blocks_ = std::clamp<Index>(ceil_div(wanted, B * ceil_div(H_, rows_)), 1, ceil_div(D_, 2));
  const Index missing = ceil_div(wanted, B * z_blocks_);
  if (ceil_div(H_, rows_) < missing)
    rows_ = std::min(rows_, std::max(kMinRows, ceil_div(H_, missing)));
  rows_ = ceil_div(H_, ceil_div(H_, rows_));  // even
  chunks_ = ceil_div(H_, rows_);
  z_size_ = ceil_div(D_, z_blocks_);
  z_blocks_ = ceil_div(D_, z_size_);
}

Piece Pieces::operator[](Index i) const {
  const Index z = i % z_blocks_ * z_size_, row = i / z_blocks_ % chunks_ * rows_;
  return {i / z_blocks_ / chunks_, row, std::min(rows_, H_ - row), z, std::min(D_, z + z_size_)};
}

template <class T>
Index rows_in_cache(const Axes& axes, Index C, Index planes) {
  Index rows = std::max<Index>(1, axes[1].most_outputs);
  while (rows > 1 && Slab<T>::bytes(axes, C, rows, planes) > kSlabBytes) rows -= ceil_div(rows, 8);
  return rows;
}

template Index rows_in_cache<float>(const Axes&, Index, Index);
template Index rows_in_cache<double>(const Axes&, Index, Index);
template class Rows<float>;
template class Rows<double>;
template class Slab<float>;
template class Slab<double>;

}  // namespace satsurf::conv

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/ops/conv_engine.h"
#include "satsurf/ops/conv_slab.h"

#include <algorithm>
#include <vector>

namespace satsurf::conv {
namespace {

constexpr Index kItems = 16;              // enough for some threads to balance
constexpr Index kMostColumns = 256;       // whose sums, one vector each, stay in the cache
constexpr Index kMostBlocks = 4;          // of outputs, alike
constexpr Index kBlockVectors = 32;       // of a gradient block that stays in the first-level cache
constexpr Index kMinVectors = 64;         // per sum, or adding up its lanes shows
constexpr Index kPartialBytes = 8 << 20;  // of all partial weight gradients together, roughly

/// The weight gradient is a matrix product over positions: dy [O, positions] by the slab's columns
/// [c and tap, positions]. Work items are groups of outputs by blocks of input channels by
/// stretches of positions; the stretches' sums are added in order.
template <class T>
class WeightGradient {
 public:
  WeightGradient(const ConvKernels<T>& kernels, const Geometry& g)
      : kernels_(kernels),
        g_(g),
        axes_(correlation_axes(g)),
        K_(g.taps()),
        c_block_(std::clamp<Index>(kMostColumns / K_, 1, g.C)),
        c_blocks_(ceil_div(g.C, c_block_)),
        planes_per_batch_(choose_batch()),
        ring_((planes_per_batch_ - 1) * axes_[0].reads + axes_[0].span()),
        pieces_(g.B, axes_, rows_in_cache<T>(axes_, c_block_, ring_), ceil_div(kItems, c_blocks_)),
        stretches_(choose_stretches()),
        o_blocks_(ceil_div(g.O, kConvBlock)),
        o_groups_(std::clamp<Index>(ceil_div(kItems, c_blocks_ * stretches_),
                                    ceil_div(o_blocks_, kMostBlocks), o_blocks_)) {}

  void run(const T* x, const T* dy, T* dw) const {
    const Index items = o_groups_ * c_blocks_, N = g_.O * g_.C * K_;
    auto partial = BasicTensor<T>::uninitialised({stretches_, N});
    for_each_index(stretches_ * items, [&](Index i) {
      const Index s = i / items, group = i % items / c_blocks_, c = i % c_blocks_ * c_block_;
      run_item(x, dy, c, group * o_blocks_ / o_groups_, (group + 1) * o_blocks_ / o_groups_,
               s * pieces_.count() / stretches_, (s + 1) * pieces_.count() / stretches_,
               partial.data() + s * N);
    });
    for_range(N, 4096, [&](Index begin, Index end) {
      for (Index s = 0; s < stretches_; ++s)
        for (Index i = begin; i < end; ++i) dw[i] += partial[s * N + i];
    });
  }

 private:
  /// Planes so small that the accumulators would be loaded and stored all the time are taken
  /// together.
  Index choose_batch() const {
    const Index rows = rows_in_cache<T>(axes_, c_block_, axes_[0].span());
    const Index vectors = ceil_div(rows * row_pitch(axes_[2]), kernels_.lanes);
    return std::clamp<Index>(kBlockVectors / vectors, 1, std::max<Index>(1, axes_[0].most));
  }

  Index choose_stretches() const {
    const Index bytes = g_.O * g_.C * K_ * static_cast<Index>(sizeof(T));
    const Index vectors = g_.B * g_.y_count() / kernels_.lanes;
    return std::min({ceil_div(kItems, c_blocks_), pieces_.count(),
                     std::max<Index>(1, kPartialBytes / bytes),
                     std::max<Index>(1, vectors / kMinVectors)});
  }

  /// The sums of input channels from c on for the output blocks [first_block, last_block) over the
  /// pieces [first, last).
  void run_item(const T* x, const T* dy, Index c, Index first_block, Index last_block, Index first,
                Index last, T* dw) const {
    const Index L = kernels_.lanes, channels = std::min(c_block_, g_.C - c);
    Slab<T> slab(kernels_, axes_, channels, pieces_.rows(), ring_);
    const Index vectors = ceil_div(pieces_.rows() * slab.pitch(), L);
    auto packed = BasicTensor<T>::uninitialised({planes_per_batch_ * vectors * kConvBlock * L});
    auto line = BasicTensor<T>::uninitialised({vectors * L});
    std::vector<BasicTensor<T>> sums;
    for (Index block = first_block; block < last_block; ++block)
      sums.push_back(BasicTensor<T>({column_count(channels, block) * outputs_of(block) * L}));

    for (Index i = first; i < last; ++i) {
      const Piece piece = pieces_[i];
      slab.open(x + (piece.b * g_.C + c) * g_.x_count(), piece.row);
      const Index used = ceil_div(piece.rows * slab.pitch(), L);
      for (Index z = piece.z; z < piece.z_end; z += planes_per_batch_) {
        const Index planes = std::min(planes_per_batch_, piece.z_end - z);
        slab.load(z * axes_[0].reads, (z + planes - 1) * axes_[0].reads + axes_[0].span());
        const std::vector<Index> columns = list_columns(slab, z, planes, channels);
        for (Index block = first_block; block < last_block; ++block) {
          for (Index p = 0; p < planes; ++p)
            pack(dy, piece, z + p, block * kConvBlock, outputs_of(block), slab.pitch(), used,
                 line.data(), packed.data() + p * used * outputs_of(block) * L);
          add_products(slab, planes, used, outputs_of(block), column_count(channels, block),
                       columns, packed.data(),
                       sums[static_cast<std::size_t>(block - first_block)].data());
        }
      }
    }
    for (Index block = first_block; block < last_block; ++block)
      store(sums[static_cast<std::size_t>(block - first_block)], channels * K_, outputs_of(block),
            block * kConvBlock, c, dw);
  }

  Index outputs_of(Index block) const { return std::min(kConvBlock, g_.O - block * kConvBlock); }

  /// Weight columns of a block of channels, filled up to whole register tiles.
  Index column_count(Index channels, Index block) const {
    const Index group = kernels_.column_group[outputs_of(block)];
    return ceil_div(channels * K_, group) * group;
  }

  /// Distance between the planes of list_columns: room for every tile size.
  Index columns_stride(Index channels) const { return channels * K_ + kConvBlock; }

  /// What each weight column (channel, tap) reads beside position 0 of the output planes from z on;
  /// spare columns repeat the first.
  std::vector<Index> list_columns(const Slab<T>& slab, Index z, Index planes,
                                  Index channels) const {
    std::vector<Index> columns;
    columns.reserve(static_cast<std::size_t>(planes * columns_stride(channels)));
    for (Index p = 0; p < planes; ++p) {
      const std::size_t begin = columns.size();
      for (const AxisTap& i : axes_[0].phases[0].taps)
        for (const AxisTap& j : axes_[1].phases[0].taps)
          for (const AxisTap& k : axes_[2].phases[0].taps)
            columns.push_back(slab.shift(z + p, i, j, k));
      for (Index q = K_; q < channels * K_; ++q)
        columns.push_back(columns[columns.size() - static_cast<std::size_t>(K_)] + slab.c_stride());
      columns.insert(columns.end(), static_cast<std::size_t>(kConvBlock), columns[begin]);
    }
    return columns;
  }

  /// The gradient of `outputs` channels at the positions of one plane, zero where no output is.
  void pack(const T* dy, const Piece& piece, Index z, Index o, Index outputs, Index pitch,
            Index vectors, T* line, T* packed) const {
    const Index H = g_.y_size[1], W = g_.y_size[2], L = kernels_.lanes;
    for (Index i = 0; i < outputs; ++i) {
      const T* src = dy + (((piece.b * g_.O + o + i) * g_.y_size[0] + z) * H + piece.row) * W;
      for (Index r = 0; r < piece.rows; ++r) {
        std::copy_n(src + r * W, W, line + r * pitch);
        std::fill(line + r * pitch + W, line + (r + 1) * pitch, T(0));
      }
      std::fill(line + piece.rows * pitch, line + vectors * L, T(0));
      for (Index v = 0; v < vectors; ++v)
        std::copy_n(line + v * L, L, packed + (v * outputs + i) * L);
    }
  }

  /// Adds the products of all positions of some planes, in blocks that stay in the first-level
  /// cache.
  void add_products(const Slab<T>& slab, Index planes, Index vectors, Index outputs,
                    Index column_count, const std::vector<Index>& columns, const T* packed,
                    T* sums) const {
    const Index groups = column_count / kernels_.column_group[outputs];
    const Index columns_stride = static_cast<Index>(columns.size()) / planes;
    std::vector<ConvSegment> block;
    Index size = 0;
    const auto flush = [&] {
      kernels_.weight_gradient(slab.data(), block.data(), static_cast<Index>(block.size()), packed,
                               outputs, groups, sums);
      packed += size * outputs * kernels_.lanes;
      block.clear();
      size = 0;
    };
    for (Index p = 0; p < planes; ++p)
      for (Index v = 0; v < vectors;) {
        const Index n = std::min(vectors - v, kBlockVectors - size);
        block.push_back({columns.data() + p * columns_stride, v * kernels_.lanes, n});
        v += n;
        size += n;
        if (size == kBlockVectors) flush();
      }
    if (size > 0) flush();
  }

  void store(const BasicTensor<T>& sums, Index Q, Index outputs, Index o, Index c, T* dw) const {
    std::vector<T> flat(static_cast<std::size_t>(Q * outputs));
    kernels_.sum_lanes(sums.data(), Q * outputs, flat.data());
    for (Index i = 0; i < outputs; ++i)
      for (Index q = 0; q < Q; ++q)
        dw[((o + i) * g_.C + c) * K_ + q] = flat[static_cast<std::size_t>(q * outputs + i)];
  }

  const ConvKernels<T>& kernels_;
  const Geometry& g_;
  const Axes axes_;
  const Index K_, c_block_, c_blocks_, planes_per_batch_, ring_;
  const Pieces pieces_;
  const Index stretches_, o_blocks_, o_groups_;
};

}  // namespace

template <class T>
void correlate_weight_gradient(const ConvKernels<T>& kernels, const Geometry& g, const T* x,
                               const T* dy, T* dw) {
  if (g.B > 0) WeightGradient<T>(kernels, g).run(x, dy, dw);
}

template <class T>
void bias_gradient(const ConvKernels<T>& kernels, Index B, Index C, Index N, const T* dy, T* db) {
  std::vector<T> sums(static_cast<std::size_t>(B * C));
  for_each_index(B * C,
                 [&](Index i) { sums[static_cast<std::size_t>(i)] = kernels.sum(dy + i * N, N); });
  for (Index b = 0; b < B; ++b)
    for (Index c = 0; c < C; ++c) db[c] += sums[static_cast<std::size_t>(b * C + c)];
}

template void correlate_weight_gradient(const ConvKernels<float>&, const Geometry&, const float*,
                                        const float*, float*);
template void correlate_weight_gradient(const ConvKernels<double>&, const Geometry&, const double*,
                                        const double*, double*);
template void bias_gradient(const ConvKernels<float>&, Index, Index, Index, const float*, float*);
template void bias_gradient(const ConvKernels<double>&, Index, Index, Index, const double*,
                            double*);

}  // namespace satsurf::conv

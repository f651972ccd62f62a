// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/ops/conv/engine.h"
#include "satsurf/ops/conv/slab.h"
#include "satsurf/ops/conv/winograd.h"

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
/// [c and tap, positions]. Where the slab's rows are mixed there is one such product per mix, of
/// the mixed gradient and the columns of that mix, and its result belongs to the mixed kernel. Work
/// items are groups of outputs by blocks of input channels by stretches of positions; the
/// stretches' sums are added in order.
template <class T>
class WeightGradient {
 public:
  WeightGradient(const ConvKernels<T>& kernels, const Geometry& g)
      : kernels_(kernels),
        g_(g),
        axes_(with_mixed_rows(correlation_axes(g), g.B)),
        kernel_(kernel_of(axes_, g)),
        mixes_(std::ssize(axes_[1].phases)),
        K_(kernel_[0] * kernel_[1] * kernel_[2] / mixes_),
        c_block_(std::clamp<Index>(kMostColumns / (K_ * mixes_), 1, g.C)),
        c_blocks_(ceil_div(g.C, c_block_)),
        planes_per_batch_(choose_batch()),
        ring_((planes_per_batch_ - 1) * axes_[0].input_phases + axes_[0].span()),
        pieces_(g.B, axes_, rows_in_cache<T>(axes_, c_block_, ring_), ceil_div(kItems, c_blocks_)),
        stretches_(choose_stretches()),
        o_blocks_(ceil_div(g.O, kConvBlock)),
        o_groups_(std::clamp<Index>(ceil_div(kItems, c_blocks_ * stretches_),
                                    ceil_div(o_blocks_, kMostBlocks), o_blocks_)),
        zeros_({g.y_size[2]}) {}

  void run(const Input<T>& x, const Input<T>& dy, T* dw) const {
    const Index items = o_groups_ * c_blocks_, N = g_.O * g_.C * g_.taps();
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
    return std::clamp<Index>(kBlockVectors / vectors, 1, std::max<Index>(1, axes_[0].most_outputs));
  }

  Index choose_stretches() const {
    const Index bytes = g_.O * g_.C * g_.taps() * static_cast<Index>(sizeof(T));
    const Index vectors = g_.B * g_.y_count() / kernels_.lanes;
    return std::min({ceil_div(kItems, c_blocks_), pieces_.count(),
                     std::max<Index>(1, kPartialBytes / bytes),
                     std::max<Index>(1, vectors / kMinVectors)});
  }

  /// The sums of input channels from c on for the output blocks [first_block, last_block) over the
  /// pieces [first, last).
  void run_item(const Input<T>& x, const Input<T>& dy, Index c, Index first_block, Index last_block,
                Index first, Index last, T* dw) const {
    const Index L = kernels_.lanes, channels = std::min(c_block_, g_.C - c);
    Slab<T> slab(kernels_, axes_, x, g_.B * g_.C, channels, pieces_.rows(), ring_);
    Rows<T> gradient(kernels_, dy, g_.B * g_.O, g_.y_size[2], winograd::kOutputs);
    const Index plane = ceil_div(pieces_.rows() * slab.pitch(), L) * L;
    auto lines = BasicTensor<T>::uninitialised(
        {mixes_, kConvBlock, odd_lines<T>(planes_per_batch_ * plane)});
    std::vector<BasicTensor<T>> sums;
    for (Index block = first_block; block < last_block; ++block)
      sums.push_back(
          BasicTensor<T>({mixes_, column_count(channels, block) * outputs_of(block) * L}));

    for (Index i = first; i < last; ++i) {
      const Piece piece = pieces_[i];
      slab.start(piece.b * g_.C + c, piece.row);
      for (Index z = piece.z; z < piece.z_end; z += planes_per_batch_) {
        const Index planes = std::min(planes_per_batch_, piece.z_end - z);
        slab.load(z * axes_[0].input_phases,
                  (z + planes - 1) * axes_[0].input_phases + axes_[0].span());
        std::vector<std::vector<Index>> columns;
        for (const AxisPhase& phase : axes_[1].phases)
          columns.push_back(list_columns(slab, z, planes, channels, phase));
        for (Index block = first_block; block < last_block; ++block) {
          for (Index p = 0; p < planes; ++p)
            lay_out(gradient, piece, z + p, block * kConvBlock, outputs_of(block), slab.pitch(),
                    p * plane, lines);
          BasicTensor<T>& block_sums = sums[block - first_block];
          for (Index m = 0; m < mixes_; ++m)
            add_products(slab, planes, ceil_div(piece.rows * slab.pitch(), L), plane,
                         outputs_of(block), column_count(channels, block), columns[m],
                         lines.data() + m * kConvBlock * lines.dim(2), lines.dim(2),
                         block_sums.data() + m * block_sums.dim(1));
        }
      }
    }
    for (Index block = first_block; block < last_block; ++block)
      store(sums[block - first_block], channels, outputs_of(block), block * kConvBlock, c, dw);
  }

  Index outputs_of(Index block) const { return std::min(kConvBlock, g_.O - block * kConvBlock); }

  /// Weight columns of a block of channels and one mix, filled up to whole register tiles.
  Index column_count(Index channels, Index block) const {
    const Index group = kernels_.column_group[outputs_of(block)];
    return ceil_div(channels * K_, group) * group;
  }

  /// Distance between the planes of list_columns: room for every tile size.
  Index columns_stride(Index channels) const { return channels * K_ + kConvBlock; }

  /// What each weight column (channel, tap) of one mix reads beside position 0 of the output planes
  /// from z on; spare columns repeat the first.
  std::vector<Index> list_columns(const Slab<T>& slab, Index z, Index planes, Index channels,
                                  const AxisPhase& rows) const {
    std::vector<Index> columns;
    columns.reserve(planes * columns_stride(channels));
    for (Index p = 0; p < planes; ++p) {
      const std::size_t begin = columns.size();
      for (const AxisTap& i : axes_[0].phases[0].taps)
        for (const AxisTap& j : rows.taps)
          for (const AxisTap& k : axes_[2].phases[0].taps)
            columns.push_back(slab.shift(z + p, i, j, k));
      for (Index q = K_; q < channels * K_; ++q)
        columns.push_back(columns[columns.size() - K_] + slab.c_stride());
      columns.insert(columns.end(), kConvBlock, columns[begin]);
    }
    return columns;
  }

  /// The gradient of `outputs` channels in the slab's layout, rows mixed like its rows, zero where
  /// no output is; position 0 of the plane goes to element `first` of each line.
  void lay_out(Rows<T>& dy, const Piece& piece, Index z, Index o, Index outputs, Index pitch,
               Index first, BasicTensor<T>& lines) const {
    using namespace winograd;
    const Index D = g_.y_size[0], H = g_.y_size[1], W = g_.y_size[2], L = kernels_.lanes;
    const Index stride = lines.dim(2), mix_stride = kConvBlock * stride;
    const Index used = piece.rows * pitch;
    for (Index i = 0; i < outputs; ++i) {
      const Index channel = piece.b * g_.O + o + i;
      const T* src = dy.input() + (channel * D + z) * H * W;
      T* dst = lines.data() + i * stride + first;
      for (Index r = 0; r < piece.rows; ++r) {
        if (axes_[1].mixed) {
          std::array<const T*, kOutputs> rows;
          for (Index j = 0; j < kOutputs; ++j) {
            const Index y = (piece.row + r) * kOutputs + j;
            rows[j] = y < H ? dy.read(src + y * W, channel, j) : zeros_.data();
          }
          kernels_.rows.mix_gradient(rows.data(), W, dst + r * pitch, mix_stride, pitch);
        } else {
          kernels_.rows.pad(dy.read(src + (piece.row + r) * W, channel, 0), W, 0, 1,
                            dst + r * pitch, 0, pitch);
        }
      }
      for (Index m = 0; m < mixes_; ++m)
        std::fill(dst + m * mix_stride + used, dst + m * mix_stride + ceil_div(used, L) * L, T(0));
    }
  }

  /// Adds the products of all positions of some planes, in blocks that stay in the first-level
  /// cache.
  void add_products(const Slab<T>& slab, Index planes, Index vectors, Index plane, Index outputs,
                    Index column_count, const std::vector<Index>& columns, const T* lines,
                    Index line_stride, T* sums) const {
    const Index groups = column_count / kernels_.column_group[outputs];
    const Index columns_stride = std::ssize(columns) / planes;
    std::vector<ConvSegment> block;
    Index size = 0;
    const auto flush = [&] {
      kernels_.weight_gradient(slab.data(), block.data(), std::ssize(block), lines, line_stride,
                               outputs, groups, sums);
      block.clear();
      size = 0;
    };
    for (Index p = 0; p < planes; ++p)
      for (Index v = 0; v < vectors;) {
        const Index n = std::min(vectors - v, kBlockVectors - size);
        block.push_back({columns.data() + p * columns_stride, p * plane, v * kernels_.lanes, n});
        v += n;
        size += n;
        if (size == kBlockVectors) flush();
      }
    if (size > 0) flush();
  }

  void store(const BasicTensor<T>& sums, Index channels, Index outputs, Index o, Index c,
             T* dw) const {
    using namespace winograd;
    const Index Q = sums.dim(1) / (outputs * kernels_.lanes), KD = kernel_[0], KW = kernel_[2];
    std::vector<T> flat(mixes_ * Q * outputs);
    kernels_.sum_lanes(sums.data(), mixes_ * Q * outputs, flat.data());
    const auto sum_of = [&](Index m, Index q, Index i) { return flat[(m * Q + q) * outputs + i]; };
    for (Index i = 0; i < outputs; ++i)
      for (Index j = 0; j < channels; ++j) {
        T* kernel = dw + ((o + i) * g_.C + c + j) * g_.taps();
        if (!axes_[1].mixed) {
          for (Index t = 0; t < K_; ++t) kernel[t] = sum_of(0, j * K_ + t, i);
          continue;
        }
        for (Index d = 0; d < KD; ++d)
          for (std::size_t t = 0; t < kTaps; ++t)
            for (Index k = 0; k < KW; ++k) {
              double sum = 0;
              for (Index m = 0; m < kMixes; ++m)
                sum += kG[m][t] * sum_of(m, (j * KD + d) * KW + k, i);
              kernel[(d * kTaps + axes_[1].kernel_order[t]) * KW + k] = static_cast<T>(sum);
            }
      }
  }

  const ConvKernels<T>& kernels_;
  const Geometry& g_;
  const Axes axes_;
  const std::array<Index, 3> kernel_;
  const Index mixes_;  ///< of the rows, 1 for none
  const Index K_;      ///< taps of each
  const Index c_block_, c_blocks_, planes_per_batch_, ring_;
  const Pieces pieces_;
  const Index stretches_, o_blocks_, o_groups_;
  const BasicTensor<T> zeros_;
};

}  // namespace

template <class T>
void correlate_weight_gradient(const ConvKernels<T>& kernels, const Geometry& g, const Input<T>& x,
                               const Input<T>& dy, T* dw) {
  if (g.B > 0) WeightGradient<T>(kernels, g).run(x, dy, dw);
}

template <class T>
void bias_gradient(const ConvKernels<T>& kernels, Index B, Index C, Index N, const T* dy, T* db) {
  std::vector<T> sums(B * C);
  for_each_index(B * C, [&](Index i) { sums[i] = kernels.sum(dy + i * N, N); });
  for (Index b = 0; b < B; ++b)
    for (Index c = 0; c < C; ++c) db[c] += sums[b * C + c];
}

template void correlate_weight_gradient(const ConvKernels<float>&, const Geometry&,
                                        const Input<float>&, const Input<float>&, float*);
template void correlate_weight_gradient(const ConvKernels<double>&, const Geometry&,
                                        const Input<double>&, const Input<double>&, double*);
template void bias_gradient(const ConvKernels<float>&, Index, Index, Index, const float*, float*);
template void bias_gradient(const ConvKernels<double>&, Index, Index, Index, const double*,
                            double*);

}  // namespace satsurf::conv

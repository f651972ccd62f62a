// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/matmul.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/isa.h"
#include "satsurf/core/parallel.h"
#include "satsurf/ops/matmul_kernels.h"

#include <algorithm>

/// The product is made of tiles of a few rows by a few vectors of columns, whose sums stay in
/// registers while k runs. Both factors are packed in the order in which tiles read them, however
/// they are stored:
///   b  once for all: panels of a tile's columns, in blocks of k;
///   a  by each piece of rows for itself: tiles of rows, one block of k after the other.
/// Blocks of k are so short that a panel and the rows of a piece stay in the second-level cache
/// together, because tiles read the panel anew for all those rows and the rows for every panel, and
/// so long that tiles seldom go to memory.
namespace satsurf {
namespace {

constexpr Index kBlockK = 256;         // elements of k in a block, at most
constexpr Index kPieceRows = 64;       // rows that read a panel while it is in the cache, at least
constexpr Index kPacked = 1 << 16;     // elements that a piece packs at a time, at most
constexpr Index kPieceWork = 1 << 20;  // multiply-adds that are worth a piece
constexpr Index kPieces = 16;          // wanted, where there is work for them
constexpr Index kGroupPanels = 4;      // panels that are worth packing rows for them alone
constexpr Index kPartK = 512;          // elements of k that are worth sums of their own
constexpr Index kPartSums = 1 << 16;   // sums that stay in the cache

Index ceil_div(Index n, Index d) { return (n + d - 1) / d; }

/// The rows of op(a), or the columns of op(b).
template <class T>
struct Lines {
  const T* data;
  Index stride;
  bool along_k;  ///< a line's elements stand beside each other

  const T* at(Index line, Index k) const {
    return along_k ? data + line * stride + k : data + k * stride + line;
  }
};

/// Vectors of columns in panels of nearly equal width.
struct Panels {
  Index count, least, wider;  ///< `wider` of `count` have `least` + 1 vectors

  Panels(Index vectors, Index most)
      : count(ceil_div(vectors, most)), least(vectors / count), wider(vectors % count) {}
  Index first(Index p) const { return p * least + std::min(p, wider); }
  Index vectors(Index p) const { return p < wider ? least + 1 : least; }
};

/// What is computed in parallel: some rows of the product, and of those all panels or a group.
struct Pieces {
  Index rows, row_pieces, panels, groups;

  Pieces(Index M, Index N, Index K, Index block, Index tile_rows, Index panel_count) {
    const Index most = std::clamp(kPieceWork / (N * K), kPieceRows, kPacked / block);
    rows = ceil_div(ceil_div(M, ceil_div(M, most)), tile_rows) * tile_rows;
    row_pieces = ceil_div(M, rows);
    panels =
        ceil_div(panel_count, std::clamp(std::min(kPieces / row_pieces, rows * N * K / kPieceWork),
                                         Index{1}, ceil_div(panel_count, kGroupPanels)));
    groups = ceil_div(panel_count, panels);
  }
};

template <class T>
void multiply(const MatmulKernels<T>& kernels, Index M, Index N, Index K, const Lines<T>& a,
              const Lines<T>& b, T* out, bool accumulate) {
  const Index L = kernels.lanes, vectors = ceil_div(N, L);
  const Index block = ceil_div(K, ceil_div(K, kBlockK));
  const Panels panels(vectors, kernels.tile_vectors);
  const auto columns = [&](Index p) {
    return std::min(panels.vectors(p) * L, N - panels.first(p) * L);
  };
  auto packed = BasicTensor<T>::uninitialised({K * vectors * L});
  const auto panel_at = [&](Index k, Index p) {
    return packed.data() + (k * vectors + panels.first(p) * std::min(block, K - k)) * L;
  };
  for_range(panels.count, kPacked / (K * panels.vectors(0) * L), [&](Index begin, Index end) {
    for (Index k = 0; k < K; k += block)
      for (Index p = begin; p < end; ++p)
        kernels.pack_columns(b.at(panels.first(p) * L, k), b.stride, b.along_k, columns(p),
                             panels.vectors(p), std::min(block, K - k), panel_at(k, p));
  });

  const Pieces pieces(M, N, K, block, kernels.tile_rows, panels.count);
  for_each_index(pieces.row_pieces * pieces.groups, [&](Index i) {
    const Index m = i % pieces.row_pieces * pieces.rows, rows = std::min(pieces.rows, M - m);
    const Index first = i / pieces.row_pieces * pieces.panels,
                end = std::min(first + pieces.panels, panels.count);
    auto tiles = BasicTensor<T>::uninitialised({pieces.rows * block});
    for (Index k = 0; k < K; k += block) {
      const Index depth = std::min(block, K - k);
      kernels.pack_rows(a.at(m, k), a.stride, a.along_k, rows, depth, tiles.data());
      for (Index p = first; p < end; ++p)
        kernels.multiply(tiles.data(), rows, panel_at(k, p), panels.vectors(p), columns(p), depth,
                         out + m * N + panels.first(p) * L, N, accumulate || k > 0);
    }
  });
}

}  // namespace

template <class T>
void gemm(const MatmulKernels<T>& kernels, Index M, Index N, Index K, const T* a, bool transpose_a,
          const T* b, bool transpose_b, T* out, bool accumulate) {
  if (M == 0 || N == 0) return;
  if (K == 0) {
    if (!accumulate) std::fill(out, out + M * N, T(0));
    return;
  }
  const Lines<T> left{a, transpose_a ? M : K, !transpose_a};
  const Lines<T> right{b, transpose_b ? K : N, transpose_b};
  // A small product of long sums has too few pieces, and its packed factors would go through memory
  // between packing and use: parts of k get sums of their own, which are added in order.
  const Index parts =
      M * N > kPartSums ? 1 : std::min(kPieces / ceil_div(M, kPieceRows), K / kPartK);
  if (parts <= 1) return multiply(kernels, M, N, K, left, right, out, accumulate);
  const Index part = ceil_div(K, parts);
  auto sums = BasicTensor<T>::uninitialised({parts, M, N});
  for_each_index(parts, [&](Index i) {
    const Index k = i * part;
    multiply(kernels, M, N, std::min(part, K - k), {left.at(0, k), left.stride, left.along_k},
             {right.at(0, k), right.stride, right.along_k}, sums.data() + i * M * N, false);
  });
  for_range(M * N, kPartSums / parts, [&](Index begin, Index end) {
    if (!accumulate) std::fill(out + begin, out + end, T(0));
    for (Index i = 0; i < parts; ++i)
      for (Index o = begin; o < end; ++o) out[o] += sums[i * M * N + o];
  });
}
template void gemm(const MatmulKernels<float>&, Index, Index, Index, const float*, bool,
                   const float*, bool, float*, bool);
template void gemm(const MatmulKernels<double>&, Index, Index, Index, const double*, bool,
                   const double*, bool, double*, bool);

template <class T>
BasicVar<T> matmul(const BasicVar<T>& a, const BasicVar<T>& b, bool transpose_a, bool transpose_b) {
  Dims dim("matmul");
  dim.match("a", a, transpose_a ? "K M" : "M K").match("b", b, transpose_b ? "N K" : "K N");
  const Index M = dim["M"], N = dim["N"], K = dim["K"];
  const auto& kernels = active_kernels<MatmulKernels<T>>();

  auto out = BasicTensor<T>::uninitialised({M, N});
  gemm(kernels, M, N, K, a.value().data(), transpose_a, b.value().data(), transpose_b, out.data(),
       false);
  return BasicVar<T>::record("matmul", out, {a, b}, [=, &kernels](Node<T>& n) {
    const T *g = n.grad.data(), *x = n.in(0), *y = n.in(1);
    if (T* da = n.grad_in(0)) {
      if (transpose_a)
        gemm(kernels, K, M, N, y, transpose_b, g, true, da, true);
      else
        gemm(kernels, M, K, N, g, false, y, !transpose_b, da, true);
    }
    if (T* db = n.grad_in(1)) {
      if (transpose_b)
        gemm(kernels, N, K, M, g, true, x, transpose_a, db, true);
      else
        gemm(kernels, K, N, M, x, !transpose_a, g, false, db, true);
    }
  });
}

template BasicVar<float> matmul(const BasicVar<float>&, const BasicVar<float>&, bool, bool);
template BasicVar<double> matmul(const BasicVar<double>&, const BasicVar<double>&, bool, bool);

}  // namespace satsurf

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/isa.h"
#include "satsurf/core/shape.h"

namespace satsurf {

/// Inner loops of the matrix product for one instruction set. They know nothing of blocks and
/// threads, which are the caller's (matmul.cpp).
template <class T>
struct MatmulKernels {
  Index lanes;         ///< elements per vector
  Index tile_rows;     ///< rows of the product that registers hold at a time
  Index tile_vectors;  ///< and of its columns, in vectors, at most

  /// Lays rows of the left factor side by side, in tiles of `tile_rows` one after another:
  ///   packed[tile][k][r] = element k of the tile's row r, 0 beyond the last row
  /// x  element k of row r is x[r * stride + k], or x[k * stride + r] unless `along_k`
  void (*pack_rows)(const T* x, Index stride, bool along_k, Index rows, Index K, T* packed);

  /// Likewise columns of the right factor, in one panel:
  ///   packed[k][c] = element k of column c, 0 for the rest of the last vector
  /// vectors  that `columns` fill, in part the last
  void (*pack_columns)(const T* x, Index stride, bool along_k, Index columns, Index vectors,
                       Index K, T* packed);

  /// out[r * stride + c] = sum_k a[r][k] b[k][c], or that added if `accumulate`
  /// a  rows packed by `pack_rows`
  /// b  a panel packed by `pack_columns`; stands at whole vectors
  void (*multiply)(const T* a, Index rows, const T* b, Index vectors, Index columns, Index K,
                   T* out, Index stride, bool accumulate);

  template <Isa isa>
  static MatmulKernels compiled_for();
};

/// out [M N] = op(a) op(b), or that added if `accumulate`; the whole product with the kernels of
/// one instruction set.
/// a  [M K], or [K M] with transpose_a
/// b  [K N], or [N K] with transpose_b
template <class T>
void gemm(const MatmulKernels<T>& kernels, Index M, Index N, Index K, const T* a, bool transpose_a,
          const T* b, bool transpose_b, T* out, bool accumulate);

}  // namespace satsurf

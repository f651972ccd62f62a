// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/matmul_kernels.h"

#include "satsurf/core/simd.h"

#include <cstddef>

namespace satsurf::SATSURF_KERNEL_ISA {
namespace {

// A tile's sums, one row of b and one element of a fill the registers: 8 x 3 + 3 + 1 of 32, or
// 4 x 3 + 3 + 1 of 16. Rows are a power of two for the sake of `transpose`.
#if defined(__AVX512F__)
constexpr Index kTileRows = 8;
#else
constexpr Index kTileRows = 4;
#endif
constexpr Index kTileVectors = 3;

template <class T, Index V>
void tile(const T* a, Index rows, const T* b, Index columns, Index K, T* out, Index stride,
          bool accumulate) {
  constexpr Index R = kTileRows, L = kLanes<T>;
  const bool whole = rows >= R && columns == V * L;
  if (whole)  // the sums are written long after this
#pragma GCC unroll 8
    for (Index r = 0; r < R; ++r)
#pragma GCC unroll 8
      for (Index v = 0; v < V; ++v) __builtin_prefetch(out + r * stride + v * L, 1);
  Batch<T> acc[R][V];
#pragma GCC unroll 8
  for (Index r = 0; r < R; ++r)
#pragma GCC unroll 8
    for (Index v = 0; v < V; ++v) acc[r][v] = Batch<T>(T(0));
  for (Index k = 0; k < K; ++k, a += R, b += V * L) {
    Batch<T> in[V];
#pragma GCC unroll 8
    for (Index v = 0; v < V; ++v) in[v] = Batch<T>::load_aligned(b + v * L);
#pragma GCC unroll 8
    for (Index r = 0; r < R; ++r) {
      const Batch<T> w(a[r]);
#pragma GCC unroll 8
      for (Index v = 0; v < V; ++v) acc[r][v] = xsimd::fma(w, in[v], acc[r][v]);
    }
  }
  if (whole) {
#pragma GCC unroll 8
    for (Index r = 0; r < R; ++r)
#pragma GCC unroll 8
      for (Index v = 0; v < V; ++v) {
        T* o = out + r * stride + v * L;
        (accumulate ? acc[r][v] + Batch<T>::load_unaligned(o) : acc[r][v]).store_unaligned(o);
      }
    return;
  }
  alignas(64) T sums[R * V * L];
#pragma GCC unroll 8
  for (Index r = 0; r < R; ++r)
#pragma GCC unroll 8
    for (Index v = 0; v < V; ++v) acc[r][v].store_aligned(sums + (r * V + v) * L);
  for (Index r = 0; r < R && r < rows; ++r)
    for (Index c = 0; c < columns; ++c) {
      T& o = out[r * stride + c];
      o = accumulate ? o + sums[r * V * L + c] : sums[r * V * L + c];
    }
}

template <class T, Index V = kTileVectors>
void multiply(const T* a, Index rows, const T* b, Index vectors, Index columns, Index K, T* out,
              Index stride, bool accumulate) {
  if constexpr (V > 1)
    if (vectors < V)
      return multiply<T, V - 1>(a, rows, b, vectors, columns, K, out, stride, accumulate);
  for (Index r = 0; r < rows; r += kTileRows)
    tile<T, V>(a + r * K, rows - r, b, columns, K, out + r * stride, stride, accumulate);
}

/// Packs one vector of each of W lines, those from `count` on as zeros.
template <class T, Index W>
void pack_square(const T* x, Index stride, Index count, Index width, T* packed) {
  constexpr Index L = kLanes<T>;
  using P = Part<T, kBatchBytes<T>>;
  typename P::Vector v[W];
#pragma GCC unroll 16
  for (Index i = 0; i < W; ++i) v[i] = i < count ? P::load(x + i * stride) : typename P::Vector{};
  transpose<T, kBatchBytes<T>>(v);
#pragma GCC unroll 16
  for (Index i = 0; i < W; ++i) P::store(packed + i * L / W * width + i * L % W, v[i]);
}

/// W of the lines of a panel, each contiguous.
template <class T, Index W>
void pack_along(const T* x, Index stride, Index count, Index width, Index K, T* packed) {
  constexpr Index L = kLanes<T>;
  Index k = 0;
  for (; k + L <= K; k += L) pack_square<T, W>(x + k, stride, count, width, packed + k * width);
  for (; k < K; ++k)
    for (Index i = 0; i < W; ++i) packed[k * width + i] = i < count ? x[i * stride + k] : T(0);
}

/// Lines whose elements k are side by side, W at a time, into G tiles or panels that stand `step`
/// apart.
template <class T, Index W, Index G>
void pack_across(const T* x, Index stride, Index count, Index width, Index K, Index step,
                 T* packed) {
  using P = Part<T, static_cast<std::size_t>(W) * sizeof(T)>;
  for (Index k = 0; k < K; ++k, x += stride, packed += width) {
    Index i = 0;
    for (; i + W * G <= count; i += W * G)
#pragma GCC unroll 8
      for (Index g = 0; g < G; ++g) P::store(packed + i + g * step, P::load(x + i + g * W));
    for (; i < count; ++i) packed[i] = x[i];
    for (; i < width; ++i) packed[i] = T(0);
  }
}

template <class T>
void pack_rows(const T* x, Index stride, bool along_k, Index rows, Index K, T* packed) {
  constexpr Index R = kTileRows, G = 4;  // tiles that share cache lines
  Index r = 0;
  for (; !along_k && r + R * G <= rows; r += R * G)
    pack_across<T, R, G>(x + r, stride, R * G, R, K, R * K, packed + r * K);
  for (; r < rows; r += R)
    if (along_k)
      pack_along<T, R>(x + r * stride, stride, rows - r, R, K, packed + r * K);
    else
      pack_across<T, R, 1>(x + r, stride, rows - r < R ? rows - r : R, R, K, 0, packed + r * K);
}

template <class T>
void pack_columns(const T* x, Index stride, bool along_k, Index columns, Index vectors, Index K,
                  T* packed) {
  constexpr Index L = kLanes<T>;
  if (!along_k) return pack_across<T, L, 1>(x, stride, columns, vectors * L, K, 0, packed);
  for (Index v = 0; v < vectors; ++v)
    pack_along<T, L>(x + v * L * stride, stride, columns - v * L, vectors * L, K, packed + v * L);
}

}  // namespace

}  // namespace satsurf::SATSURF_KERNEL_ISA

namespace satsurf {

template <class T>
template <Isa isa>
MatmulKernels<T> MatmulKernels<T>::compiled_for() {
  return {.lanes = here::kLanes<T>,
          .tile_rows = here::kTileRows,
          .tile_vectors = here::kTileVectors,
          .pack_rows = here::pack_rows<T>,
          .pack_columns = here::pack_columns<T>,
          .multiply = here::multiply<T>};
}
template MatmulKernels<float> MatmulKernels<float>::compiled_for<kIsa>();
template MatmulKernels<double> MatmulKernels<double>::compiled_for<kIsa>();

}  // namespace satsurf

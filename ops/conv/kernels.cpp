// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/conv/kernels.h"

#include "satsurf/core/simd.h"

#include <cstddef>

namespace satsurf::SATSURF_KERNEL_ISA {
namespace {

#if defined(__AVX512F__)
constexpr bool kManyRegisters = true;  // 32 vector registers, 16 otherwise
#else
constexpr bool kManyRegisters = false;
#endif

/// Vectors of one register tile of `outputs` channels: as many accumulators as registers allow
/// beside the inputs, and never so few that the multiply-adds wait for each other.
constexpr Index tile_vectors(Index outputs) {
  if (kManyRegisters) return outputs == 8 ? 3 : outputs == 4 ? 6 : 8;
  return outputs == 4 ? 3 : outputs == 2 ? 4 : 6;
}

/// Weight columns of one register tile, chosen alike.
constexpr Index tile_columns(Index outputs) {
  if (kManyRegisters) return outputs == 8 ? 3 : outputs == 4 ? 6 : 8;
  return outputs == 4 ? 3 : outputs == 2 ? 4 : 6;
}

/// Asks for what the V vectors behind those at x hold: every tap starts on other cache lines, and
/// these streams are too many for the processor to foresee.
template <class T, Index V>
void prefetch_behind(const T* x) {
  constexpr Index kLine = 64 / static_cast<Index>(sizeof(T)), kVectors = V * kLanes<T>;
#pragma GCC unroll 8
  for (Index i = 0; i < kVectors; i += kLine) __builtin_prefetch(x + kVectors + i);
}

/// kFirst  whether these outputs are the first to read what the tile reads
template <class T, Index O, Index V, bool kFirst>
void gather_tile(const ConvGather<T>& g, const T* x, const T* weight, const T* bias, T* out) {
  constexpr Index L = kLanes<T>;
  Batch<T> acc[O][V];
#pragma GCC unroll 8
  for (Index o = 0; o < O; ++o)
#pragma GCC unroll 8
    for (Index v = 0; v < V; ++v) acc[o][v] = Batch<T>(bias[o]);
  for (Index c = 0; c < g.C; ++c, x += g.c_stride)
    for (Index t = 0; t < g.taps; ++t, weight += kConvBlock) {
      const T* xt = x + g.shift[t];
      if constexpr (kFirst) prefetch_behind<T, V>(xt);
      Batch<T> in[V];
#pragma GCC unroll 8
      for (Index v = 0; v < V; ++v) in[v] = Batch<T>::load_unaligned(xt + v * L);
#pragma GCC unroll 8
      for (Index o = 0; o < O; ++o) {
        const Batch<T> w(weight[o]);
#pragma GCC unroll 8
        for (Index v = 0; v < V; ++v) acc[o][v] = xsimd::fma(w, in[v], acc[o][v]);
      }
    }
  if (g.add)
#pragma GCC unroll 8
    for (Index o = 0; o < O; ++o)
#pragma GCC unroll 8
      for (Index v = 0; v < V; ++v)
        acc[o][v] += Batch<T>::load_unaligned(out + o * g.out_stride + v * L);
#pragma GCC unroll 8
  for (Index o = 0; o < O; ++o)
#pragma GCC unroll 8
    for (Index v = 0; v < V; ++v) acc[o][v].store_unaligned(out + o * g.out_stride + v * L);
}

/// V vectors of all outputs, one group of them after another: what the first group has read is in
/// the first-level cache for the others.
template <class T, Index V>
void gather_outputs(const ConvGather<T>& g, const T* x, T* out) {
  const auto group = [&]<Index O, bool kFirst>(Index o) {
    gather_tile<T, O, V, kFirst>(g, x, g.weight + o, g.bias + o, out + o * g.out_stride);
  };
  Index o = 0;
  const auto run = [&]<Index O>() {
    if (o == 0 && g.outputs >= O) {
      group.template operator()<O, true>(0);
      o = O;
    }
    for (; g.outputs - o >= O; o += O) group.template operator()<O, false>(o);
  };
  if constexpr (kManyRegisters) run.template operator()<8>();
  run.template operator()<4>();
  run.template operator()<2>();
  run.template operator()<1>();
}

/// Tiles of V vectors while they fit, then of half as many, down to one.
template <class T, Index V>
void gather_vectors(const ConvGather<T>& g, Index vectors, const T* x, T* out) {
  constexpr Index L = kLanes<T>;
  for (; vectors >= V; vectors -= V, x += V * L, out += V * L) gather_outputs<T, V>(g, x, out);
  if constexpr (V > 1) gather_vectors<T, (V + 1) / 2>(g, vectors, x, out);
}

template <class T>
void gather(const ConvGather<T>& g, Index n) {
  const Index vectors = (n + kLanes<T> - 1) / kLanes<T>;
  const auto run = [&]<Index O>() { gather_vectors<T, tile_vectors(O)>(g, vectors, g.x, g.out); };
  if (kManyRegisters && g.outputs >= 8) return run.template operator()<8>();
  if (g.outputs >= 4) return run.template operator()<4>();
  if (g.outputs >= 2) return run.template operator()<2>();
  run.template operator()<1>();
}

/// P neighbouring outputs, those of one position in one vector.
template <class T, Index P, Index kStep>
void lanes_tile(const ConvGather<T>& g, const T* x, T* out) {
  constexpr Index L = kLanes<T>;
  const T* weight = g.weight;
  Batch<T> acc[P];
#pragma GCC unroll 16
  for (Index p = 0; p < P; ++p) acc[p] = Batch<T>::load_aligned(g.bias);
  for (Index c = 0; c < g.C; ++c, x += g.c_stride)
    for (Index t = 0; t < g.taps; ++t, weight += L) {
      const T* xt = x + g.shift[t];
      const Batch<T> w = Batch<T>::load_aligned(weight);
#pragma GCC unroll 16
      for (Index p = 0; p < P; ++p) acc[p] = xsimd::fma(w, Batch<T>(xt[p * kStep]), acc[p]);
    }
  if constexpr (P == L) {
    using Vectors = Part<T, kBatchBytes<T>>;
    typename Vectors::Vector rows[L];
#pragma GCC unroll 16
    for (Index p = 0; p < L; ++p) rows[p] = acc[p].data;
    transpose<T, kBatchBytes<T>>(rows);
#pragma GCC unroll 16
    for (Index o = 0; o < L; ++o) {
      if (o >= g.outputs) break;
      T* to = out + o * g.out_stride;
      Vectors::store(to, g.add ? rows[o] + Vectors::load(to) : rows[o]);
    }
  } else {
    alignas(Batch<T>) T lanes[P * L];
    for (Index p = 0; p < P; ++p) acc[p].store_aligned(lanes + p * L);
    for (Index o = 0; o < g.outputs; ++o)
      for (Index p = 0; p < P; ++p) {
        T& to = out[o * g.out_stride + p];
        to = (g.add ? to : T(0)) + lanes[p * L + o];
      }
  }
}

/// Tiles of P outputs while they fit, then of half as many, down to one.
template <class T, Index kStep, Index P = kLanes<T>>
void lanes_row(const ConvGather<T>& g, Index n, const T* x, T* out) {
  for (; n >= P; n -= P, x += P * kStep, out += P) lanes_tile<T, P, kStep>(g, x, out);
  if constexpr (P > 1) lanes_row<T, kStep, P / 2>(g, n, x, out);
}

template <class T>
void gather_in_lanes(const ConvGather<T>& g, Index n, Index step) {
  (step == 1 ? lanes_row<T, 1> : lanes_row<T, 2>)(g, n, g.x, g.out);
}

/// Keeps a vector that several multiply-adds share in its register: compilers fold the load into
/// each of them instead, which makes the loads the bottleneck.
template <class T>
void keep_in_register(Batch<T>& b) {
#if defined(__AVX512F__)
  asm("" : "+v"(b.data));
#elif defined(__x86_64__)
  asm("" : "+x"(b.data));
#else
  (void)b;
#endif
}

/// One tile of O of the packed gradient's outputs by Q columns.
template <class T, Index O, Index Q>
void gradient_tile(const T* x, const ConvSegment* segments, Index count, Index column, const T* g,
                   Index g_stride, Index outputs, T* partial) {
  constexpr Index L = kLanes<T>;
  Batch<T> acc[Q][O];
#pragma GCC unroll 8
  for (Index q = 0; q < Q; ++q)
#pragma GCC unroll 8
    for (Index o = 0; o < O; ++o)
      acc[q][o] = Batch<T>::load_aligned(partial + (q * outputs + o) * L);
  for (Index s = 0; s < count; ++s) {
    const ConvSegment& segment = segments[s];
    const T* xs[Q];
#pragma GCC unroll 8
    for (Index q = 0; q < Q; ++q) xs[q] = x + segment.columns[column + q];
    const T* gs = g + segment.plane;
    const Index end = segment.first + segment.vectors * L;
    for (Index p = segment.first; p < end; p += L) {
      Batch<T> in[Q];
#pragma GCC unroll 8
      for (Index q = 0; q < Q; ++q) in[q] = Batch<T>::load_unaligned(xs[q] + p);
#pragma GCC unroll 8
      for (Index o = 0; o < O; ++o) {
        Batch<T> go = Batch<T>::load_aligned(gs + o * g_stride + p);
        keep_in_register(go);
#pragma GCC unroll 8
        for (Index q = 0; q < Q; ++q) acc[q][o] = xsimd::fma(go, in[q], acc[q][o]);
      }
    }
  }
#pragma GCC unroll 8
  for (Index q = 0; q < Q; ++q)
#pragma GCC unroll 8
    for (Index o = 0; o < O; ++o) acc[q][o].store_aligned(partial + (q * outputs + o) * L);
}

template <class T>
void weight_gradient(const T* x, const ConvSegment* segments, Index count, const T* g,
                     Index g_stride, Index outputs, Index groups, T* partial) {
  constexpr Index L = kLanes<T>;
  const auto run = [&]<Index O, Index Q>() {
    for (Index i = 0; i < groups; ++i)
      for (Index o = 0; o < outputs; o += O)
        gradient_tile<T, O, Q>(x, segments, count, i * Q, g + o * g_stride, g_stride, outputs,
                               partial + (i * Q * outputs + o) * L);
  };
  if constexpr (kManyRegisters)
    if (outputs == 8) return run.template operator()<8, tile_columns(8)>();
  if (outputs % 4 == 0) return run.template operator()<4, tile_columns(4)>();
  if (outputs % 2 == 0) return run.template operator()<2, tile_columns(2)>();
  run.template operator()<1, tile_columns(1)>();
}

/// The sum of a vector's lanes, by halves.
template <class T, std::size_t Bytes = kBatchBytes<T>>
T sum_halves(const typename Part<T, Bytes>::Vector& v) {
  if constexpr (Bytes == 2 * sizeof(T)) {
    return v[0] + v[1];
  } else {
    const auto half = [&]<Index... I>(Lanes<I...>) {
      constexpr Index H = Part<T, Bytes / 2>::kCount;
      return __builtin_shufflevector(v, v, I...) + __builtin_shufflevector(v, v, (H + I)...);
    };
    return sum_halves<T, Bytes / 2>(half(typename Part<T, Bytes / 2>::Indices{}));
  }
}

template <class T>
void sum_lanes(const T* vectors, Index n, T* out) {
  using P = Part<T, kBatchBytes<T>>;
  for (Index i = 0; i < n; ++i) out[i] = sum_halves<T>(P::load(vectors + i * kLanes<T>));
}

template <class T>
T sum(const T* x, Index n) {
  constexpr Index L = kLanes<T>;
  Batch<T> a(T(0)), b(T(0)), c(T(0)), d(T(0));
  Index i = 0;
  for (; i + 4 * L <= n; i += 4 * L) {
    a += Batch<T>::load_unaligned(x + i);
    b += Batch<T>::load_unaligned(x + i + L);
    c += Batch<T>::load_unaligned(x + i + 2 * L);
    d += Batch<T>::load_unaligned(x + i + 3 * L);
  }
  T lanes[kLanes<T>], total = 0;
  ((a + b) + (c + d)).store_unaligned(lanes);
  sum_lanes(lanes, 1, &total);
  for (; i < n; ++i) total += x[i];
  return total;
}

/// The tile that weight_gradient picks for a number of outputs.
constexpr Index column_group(Index outputs) {
  if (kManyRegisters && outputs == 8) return tile_columns(8);
  return outputs % 4 == 0 ? tile_columns(4) : outputs % 2 == 0 ? tile_columns(2) : tile_columns(1);
}

}  // namespace

}  // namespace satsurf::SATSURF_KERNEL_ISA

namespace satsurf {

template <class T>
template <Isa isa>
ConvKernels<T> ConvKernels<T>::compiled_for() {
  return {.lanes = here::kLanes<T>,
          .column_group = {0, here::column_group(1), here::column_group(2), here::column_group(3),
                           here::column_group(4), here::column_group(5), here::column_group(6),
                           here::column_group(7), here::column_group(8)},
          .keeps_channels_in_lanes = here::kManyRegisters,
          .gather = here::gather<T>,
          .gather_in_lanes = here::gather_in_lanes<T>,
          .weight_gradient = here::weight_gradient<T>,
          .sum_lanes = here::sum_lanes<T>,
          .sum = here::sum<T>,
          .rows = ConvRowKernels<T>::template compiled_for<isa>()};
}
template ConvKernels<float> ConvKernels<float>::compiled_for<kIsa>();
template ConvKernels<double> ConvKernels<double>::compiled_for<kIsa>();

}  // namespace satsurf

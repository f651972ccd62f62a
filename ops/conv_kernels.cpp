// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/conv_kernels.h"

#include "satsurf/core/simd.h"

#include <cstddef>

namespace satsurf::SATSURF_ISA_NS {
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

template <class T, Index O, Index V>
void gather_tile(const T* x, Index c_stride, Index C, const Index* shift, Index taps,
                 const T* weight, T* out, Index out_stride) {
  constexpr Index L = kLanes<T>;
  Batch<T> acc[O][V];
#pragma GCC unroll 8
  for (Index o = 0; o < O; ++o)
#pragma GCC unroll 8
    for (Index v = 0; v < V; ++v) acc[o][v] = Batch<T>(T(0));
  for (Index c = 0; c < C; ++c, x += c_stride)
    for (Index t = 0; t < taps; ++t, weight += kConvBlock) {
      const T* xt = x + shift[t];
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
#pragma GCC unroll 8
  for (Index o = 0; o < O; ++o)
#pragma GCC unroll 8
    for (Index v = 0; v < V; ++v) acc[o][v].store_unaligned(out + o * out_stride + v * L);
}

/// Tiles of V vectors while they fit, then of half as many, down to one.
template <class T, Index O, Index V>
void gather_outputs(const T* x, Index c_stride, Index C, const Index* shift, Index taps,
                    const T* weight, Index vectors, T* out, Index out_stride) {
  constexpr Index L = kLanes<T>;
  for (; vectors >= V; vectors -= V, x += V * L, out += V * L)
    gather_tile<T, O, V>(x, c_stride, C, shift, taps, weight, out, out_stride);
  if constexpr (V > 1)
    gather_outputs<T, O, (V + 1) / 2>(x, c_stride, C, shift, taps, weight, vectors, out,
                                      out_stride);
}

template <class T>
void gather(const T* x, Index c_stride, Index C, const Index* shift, Index taps, const T* weight,
            Index outputs, Index n, T* out, Index out_stride) {
  const Index vectors = (n + kLanes<T> - 1) / kLanes<T>;
  const auto run = [&]<Index O>() {
    gather_outputs<T, O, tile_vectors(O)>(x, c_stride, C, shift, taps, weight, vectors, out,
                                          out_stride);
    weight += O;
    out += O * out_stride;
    outputs -= O;
  };
  if constexpr (kManyRegisters)
    while (outputs >= 8) run.template operator()<8>();
  while (outputs >= 4) run.template operator()<4>();
  while (outputs >= 2) run.template operator()<2>();
  while (outputs >= 1) run.template operator()<1>();
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
                   Index outputs, T* partial) {
  constexpr Index L = kLanes<T>;
  Batch<T> acc[Q][O];
#pragma GCC unroll 8
  for (Index q = 0; q < Q; ++q)
#pragma GCC unroll 8
    for (Index o = 0; o < O; ++o)
      acc[q][o] = Batch<T>::load_aligned(partial + (q * outputs + o) * L);
  for (Index s = 0; s < count; ++s) {
    const T* xs[Q];
#pragma GCC unroll 8
    for (Index q = 0; q < Q; ++q) xs[q] = x + segments[s].columns[column + q] + segments[s].first;
    const Index n = segments[s].vectors * L;
    for (Index p = 0; p < n; p += L, g += outputs * L) {
      Batch<T> in[Q];
#pragma GCC unroll 8
      for (Index q = 0; q < Q; ++q) in[q] = Batch<T>::load_unaligned(xs[q] + p);
#pragma GCC unroll 8
      for (Index o = 0; o < O; ++o) {
        Batch<T> go = Batch<T>::load_aligned(g + o * L);
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
                     Index outputs, Index groups, T* partial) {
  constexpr Index L = kLanes<T>;
  const auto run = [&]<Index O, Index Q>() {
    for (Index i = 0; i < groups; ++i)
      for (Index o = 0; o < outputs; o += O)
        gradient_tile<T, O, Q>(x, segments, count, i * Q, g + o * L, outputs,
                               partial + (i * Q * outputs + o) * L);
  };
  if constexpr (kManyRegisters)
    if (outputs == 8) return run.template operator()<8, tile_columns(8)>();
  if (outputs % 4 == 0) return run.template operator()<4, tile_columns(4)>();
  if (outputs % 2 == 0) return run.template operator()<2, tile_columns(2)>();
  run.template operator()<1, tile_columns(1)>();
}

/// Indices of one vector, for the shuffles below.
template <Index... I>
struct Lanes {};
template <Index N, Index... I>
struct CountLanes : CountLanes<N - 1, N - 1, I...> {};
template <Index... I>
struct CountLanes<0, I...> {
  using Type = Lanes<I...>;
};

/// Element I of both in turn: even[0], odd[0], even[1], ..
template <class T, Index... I>
void interleave(const Batch<T>& even, const Batch<T>& odd, Batch<T>& a, Batch<T>& b, Lanes<I...>) {
  constexpr Index L = kLanes<T>;
  a = Batch<T>(__builtin_shufflevector(even.data, odd.data, (I / 2 + I % 2 * L)...));
  b = Batch<T>(__builtin_shufflevector(even.data, odd.data, (I / 2 + L / 2 + I % 2 * L)...));
}

template <class T>
using AllLanes = typename CountLanes<kLanes<T>>::Type;

/// Part of a vector, for rows shorter than one; xsimd's batches of other instruction sets would be
/// shared with the sources compiled for those.
template <class T, std::size_t Bytes>
struct Part {
  typedef T Vector __attribute__((vector_size(Bytes)));
  static constexpr Index kCount = static_cast<Index>(Bytes / sizeof(T));
  using Indices = typename CountLanes<kCount>::Type;

  static Vector load(const T* p) {
    Vector v;
    __builtin_memcpy(&v, p, Bytes);
    return v;
  }
  static void store(T* p, const Vector& v) { __builtin_memcpy(p, &v, Bytes); }
};

template <class T>
constexpr std::size_t kVectorBytes = static_cast<std::size_t>(kLanes<T>) * sizeof(T);

/// Vectors from the front and one more that ends with the row; shorter rows by shorter vectors.
template <class T, std::size_t Bytes = kVectorBytes<T>>
void copy_row(const T* src, T* dst, Index n) {
  using P = Part<T, Bytes>;
  if (n < P::kCount) {
    if constexpr (Bytes > 16) return copy_row<T, Bytes / 2>(src, dst, n);
    for (Index i = 0; i < n; ++i) dst[i] = src[i];
    return;
  }
  for (Index i = 0; i + P::kCount <= n; i += P::kCount) P::store(dst + i, P::load(src + i));
  P::store(dst + n - P::kCount, P::load(src + n - P::kCount));
}

template <class T, std::size_t Bytes, Index... I>
void split_vector(const T* src, T* even, T* odd, Lanes<I...>) {
  using P = Part<T, Bytes>;
  const auto a = P::load(src), b = P::load(src + P::kCount);
  P::store(even, __builtin_shufflevector(a, b, (2 * I)...));
  P::store(odd, __builtin_shufflevector(a, b, (2 * I + 1)...));
}

/// even[i] = src[2 i], odd[i] = src[2 i + 1], walking as copy_row does.
template <class T, std::size_t Bytes = kVectorBytes<T>>
void split_row(const T* src, T* even, T* odd, Index n) {
  using P = Part<T, Bytes>;
  constexpr typename P::Indices kIndices{};
  if (n < P::kCount) {
    if constexpr (Bytes > 16) return split_row<T, Bytes / 2>(src, even, odd, n);
    for (Index i = 0; i < n; ++i) {
      even[i] = src[2 * i];
      odd[i] = src[2 * i + 1];
    }
    return;
  }
  for (Index i = 0; i + P::kCount <= n; i += P::kCount)
    split_vector<T, Bytes>(src + 2 * i, even + i, odd + i, kIndices);
  const Index i = n - P::kCount;
  split_vector<T, Bytes>(src + 2 * i, even + i, odd + i, kIndices);
}

template <class T>
void pad_row(const T* src, Index n, Index left, Index phases, T* dst, Index phase_stride,
             Index count) {
  if (n == 0) {
    for (Index f = 0; f < phases; ++f)
      for (Index i = 0; i < count; ++i) dst[f * phase_stride + i] = T(0);
    return;
  }
  // Indices of which every phase is inside; the few around them are looked at one by one.
  Index begin = left > 0 ? (left + phases - 1) / phases : 0;
  Index end = n + left >= phases ? (n + left - phases) / phases + 1 : 0;
  if (end > count) end = count;
  if (begin > end) begin = end;
  const T* inner = src + begin * phases - left;
  if (phases == 1)
    copy_row(inner, dst + begin, end - begin);
  else if (phases == 2)
    split_row(inner, dst + begin, dst + phase_stride + begin, end - begin);
  else
    for (Index f = 0; f < phases; ++f)
      for (Index i = begin; i < end; ++i)
        dst[f * phase_stride + i] = inner[(i - begin) * phases + f];
  const auto outer = [&](Index first, Index last) {
    for (Index f = 0; f < phases; ++f)
      for (Index i = first; i < last; ++i) {
        const Index in = i * phases + f - left;
        dst[f * phase_stride + i] = in >= 0 && in < n ? src[in] : T(0);
      }
  };
  outer(0, begin);
  outer(end, count);
}

template <class T>
void interleave_row(const T* even, const T* odd, T bias, bool accumulate, T* dst, Index pairs) {
  constexpr Index L = kLanes<T>;
  Index i = 0;
  for (; i + L <= pairs; i += L) {
    Batch<T> a, b;
    interleave(Batch<T>::load_unaligned(even + i) + bias, Batch<T>::load_unaligned(odd + i) + bias,
               a, b, AllLanes<T>{});
    T* to = dst + 2 * i;
    if (accumulate) {
      a += Batch<T>::load_unaligned(to);
      b += Batch<T>::load_unaligned(to + L);
    }
    a.store_unaligned(to);
    b.store_unaligned(to + L);
  }
  for (; i < pairs; ++i) {
    dst[2 * i] = (accumulate ? dst[2 * i] : T(0)) + (even[i] + bias);
    dst[2 * i + 1] = (accumulate ? dst[2 * i + 1] : T(0)) + (odd[i] + bias);
  }
}

template <class T>
void store_row(const T* src, Index phase_stride, Index phases, T bias, bool accumulate, T* dst,
               Index n) {
  constexpr Index L = kLanes<T>;
  Index i = 0;
  if (phases == 1) {
    for (; i + L <= n; i += L) {
      Batch<T> v = Batch<T>::load_unaligned(src + i) + bias;
      if (accumulate) v += Batch<T>::load_unaligned(dst + i);
      v.store_unaligned(dst + i);
    }
  } else if (phases == 2) {
    interleave_row(src, src + phase_stride, bias, accumulate, dst, n / 2);
    i = n / 2 * 2;
  }
  for (; i < n; ++i)
    dst[i] = (accumulate ? dst[i] : T(0)) + (src[i % phases * phase_stride + i / phases] + bias);
}

/// The sum of a vector's lanes, by halves.
template <class T, std::size_t Bytes = kVectorBytes<T>>
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
  using P = Part<T, kVectorBytes<T>>;
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

template <class T>
const ConvKernels<T>& conv_kernels() {
  static constexpr ConvKernels<T> kernels{
      .lanes = kLanes<T>,
      .column_group = {0, column_group(1), column_group(2), column_group(3), column_group(4),
                       column_group(5), column_group(6), column_group(7), column_group(8)},
      .gather = gather<T>,
      .weight_gradient = weight_gradient<T>,
      .sum_lanes = sum_lanes<T>,
      .pad_row = pad_row<T>,
      .store_row = store_row<T>,
      .sum = sum<T>};
  return kernels;
}
template const ConvKernels<float>& conv_kernels();
template const ConvKernels<double>& conv_kernels();

}  // namespace satsurf::SATSURF_ISA_NS

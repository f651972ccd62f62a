// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/cost_volume_kernels.h"

#include "satsurf/core/simd.h"
#include "satsurf/ops/cost_volume.h"

#include <type_traits>

namespace satsurf::SATSURF_KERNEL_ISA {
namespace {

/// L numbers: eight channels are half a batch under AVX-512.
template <class T, Index L>
using Channels = typename Part<T, L * sizeof(T)>::Vector;

template <class V, class T>
V load(const T* p) {
  V v;
  __builtin_memcpy(&v, p, sizeof(V));
  return v;
}
template <class V, class T>
void store(T* p, const V& v) {
  __builtin_memcpy(p, &v, sizeof(V));
}
template <class V, class T>
void add_to(T* p, const V& v) {
  store(p, load<V>(p) + v);
}

/// A square of S pixels by S channels.
template <class T, Index S>
struct Square {
  using Row = Channels<T, S>;
  Row rows[S];

  Square(const T* from, Index stride) {
#pragma GCC unroll 8
    for (Index i = 0; i < S; ++i) rows[i] = load<Row>(from + i * stride);
    transpose<T, sizeof(Row)>(rows);
  }
};

/// Calls body.template operator()<S>(c, i) for squares of S channels from c on and S pixels from i on, and
/// with S = 1 for what is left of C channels and n pixels: squares of eight while there are as many
/// channels and a vector holds them, then of four.
template <class T, class Body>
void by_squares(Index n, Index C, const Body& body) {
  Index c = 0;
  const auto run = [&]<Index S>() {
    const Index whole = n / S * S;
    for (; C - c >= S; c += S) {
      for (Index i = 0; i < whole; i += S) body.template operator()<S>(c, i);
      for (Index k = c; k < c + S; ++k)
        for (Index i = whole; i < n; ++i) body.template operator()<1>(k, i);
    }
  };
  if constexpr (kLanes<T> >= 8) run.template operator()<8>();
  run.template operator()<4>();
  run.template operator()<1>();
}

/// Planes [C n] to pixels [n Cs]; channels C.. are left alone.
template <class T>
void gather_pixels(const T* planes, Index stride, Index n, Index C, Index Cs, T* pixels) {
  by_squares<T>(n, C, [&]<Index S>(Index c, Index i) {
    const T* from = planes + c * stride + i;
    T* to = pixels + i * Cs + c;
    if constexpr (S == 1) {
      *to = *from;
    } else {
      const Square<T, S> square(from, stride);
#pragma GCC unroll 8
      for (Index k = 0; k < S; ++k) store(to + k * Cs, square.rows[k]);
    }
  });
}

/// Pixels [n Cs] to planes [C n], stored or added.
template <bool kAdd, class T>
void scatter_pixels(const T* pixels, Index n, Index C, Index Cs, T* planes, Index stride) {
  const auto put = [](T* to, const auto& value) {
    using V = std::decay_t<decltype(value)>;
    if constexpr (kAdd)
      add_to<V>(to, value);
    else
      store<V>(to, value);
  };
  by_squares<T>(n, C, [&]<Index S>(Index c, Index i) {
    const T* from = pixels + i * Cs + c;
    T* to = planes + c * stride + i;
    if constexpr (S == 1) {
      put(to, *from);
    } else {
      const Square<T, S> square(from, Cs);
#pragma GCC unroll 8
      for (Index k = 0; k < S; ++k) put(to + k * stride, square.rows[k]);
    }
  });
}

template <class T>
void fill_zero(T* p, Index n) {
  for (Index i = 0; i < n; ++i) p[i] = T(0);
}

/// In double: the constant terms carry the pixel position.
template <class T>
void make_lines(const SweepMap& m, Index begin, Index n, SweepLines<T>& line) {
  for (Index i = 0; i < n; ++i) {
    const double a = static_cast<double>(begin + i) * m.ax + m.a0;
    line.u[0][i] = static_cast<T>(m.u[0] + a * (m.u[1] + a * m.u[2]));
    line.v[0][i] = static_cast<T>(m.v[0] + a * (m.v[1] + a * m.v[2]));
    line.u[1][i] = static_cast<T>(m.u[3] + a * m.u[4]);
    line.v[1][i] = static_cast<T>(m.v[3] + a * m.v[4]);
  }
  line.u2 = static_cast<T>(m.u[5]);
  line.v2 = static_cast<T>(m.v[5]);
  line.tz = static_cast<T>(m.tz);
  line.z0 = static_cast<T>(m.z0);
}

/// Positions may be anything, infinities and NaN included; neighbours always lie within the map.
template <class T>
void make_taps(const SweepLines<T>& line, const T* z, Index n, Index H, Index W, const T* valid,
               SweepTaps<T>& taps) {
  const T right = static_cast<T>(W - 1), bottom = static_cast<T>(H - 1);
  const auto last_x = static_cast<std::int32_t>(W > 1 ? W - 2 : 0);
  const auto last_y = static_cast<std::int32_t>(H > 1 ? H - 2 : 0);
  const auto width = static_cast<std::int32_t>(W);
  for (Index i = 0; i < n; ++i) {
    const T t = (z[i] - line.z0) * line.tz;
    const T u = line.u[0][i] + t * (line.u[1][i] + t * line.u2);
    const T v = line.v[0][i] + t * (line.v[1][i] + t * line.v2);
    const T u_up = u > 0 ? u : T(0), v_up = v > 0 ? v : T(0);
    const T u_in = u_up < right ? u_up : right, v_in = v_up < bottom ? v_up : bottom;
    const auto floor_x = static_cast<std::int32_t>(u_in), floor_y = static_cast<std::int32_t>(v_in);
    const std::int32_t x = floor_x < last_x ? floor_x : last_x,
                       y = floor_y < last_y ? floor_y : last_y;
    const T counts = (u_in == u ? T(1) : T(0)) * (v_in == v ? T(1) : T(0));
    const T fx = u_in - static_cast<T>(x), fy = v_in - static_cast<T>(y);
    taps.x[i] = x;
    taps.y[i] = y;
    taps.nearest[i] =
        static_cast<std::int32_t>(v_in + T(0.5)) * width + static_cast<std::int32_t>(u_in + T(0.5));
    taps.counts[i] = counts;
    taps.weight[0][i] = counts * (1 - fx) * (1 - fy);
    taps.weight[1][i] = counts * fx * (1 - fy);
    taps.weight[2][i] = counts * (1 - fx) * fy;
    taps.weight[3][i] = counts * fx * fy;
  }
  if (valid == nullptr) return;
  for (Index i = 0; i < n; ++i) {
    if (valid[taps.nearest[i]] != 0) continue;
    taps.counts[i] = 0;
    for (Index k = 0; k < 4; ++k) taps.weight[k][i] = 0;
  }
}

template <class T>
void make_all_taps(const SweepRow<T>& s, Index begin, Index n, Index d) {
  for (Index j = 0; j < s.J; ++j)
    make_taps(s.lines[j], s.heights + d * s.H * s.W + begin, n, s.H, s.W,
              s.valid == nullptr ? nullptr : s.valid[j], s.taps[j]);
}

/// The samples of one pixel and L channels, in f[0..J), and their mean. kJ = 0: J is known at run
/// time only.
template <class T, Index L, Index kJ>
struct Sampler {
  using V = Channels<T, L>;
  const SweepRow<T>& s;
  const Index J = kJ > 0 ? kJ : s.J;
  const Index right = s.W > 1 ? s.Cs : 0, down = s.H > 1 ? s.W *s.Cs : 0;

  /// Of each of `count` pixels 1 / n, or 0 where the variance is 0 by definition.
  void shares(Index count, T* out) const {
    T counted[kSweepTile];
    for (Index i = 0; i < count; ++i) counted[i] = s.reference_counts;
    for (Index j = 0; j < J; ++j) {
      const T* counts = s.taps[j].counts;
      for (Index i = 0; i < count; ++i) counted[i] += counts[i];
    }
    for (Index i = 0; i < count; ++i) {
      // A division that is always made, for one under a condition is made pixel by pixel.
      const T some = counted[i] > 1 ? counted[i] : T(1);
      out[i] = (some >= 2 ? T(1) : T(0)) * (1 / some);
    }
  }
  Index offset(Index j, Index i) const { return (s.taps[j].y[i] * s.W + s.taps[j].x[i]) * s.Cs; }
  V mean(Index i, Index c, const V& own, T share_of, V* f) const {
    V total = own * s.reference_counts;
    for (Index j = 0; j < J; ++j) {
      const SweepTaps<T>& t = s.taps[j];
      const T* p = s.sources[j] + offset(j, i) + c;
      f[j] = load<V>(p) * t.weight[0][i] + load<V>(p + right) * t.weight[1][i] +
             load<V>(p + down) * t.weight[2][i] + load<V>(p + down + right) * t.weight[3][i];
      total += f[j];
    }
    return total * share_of;
  }
};

/// Numbers in which the squares of L channels read together are summed; number l has those of the
/// channels that are l modulo 4.
template <Index L>
constexpr Index kSums = L < 4 ? 4 : L;

/// Four sums of L or more by their index modulo 4.
template <Index L, class T>
Channels<T, 4> quarters(const T* sums) {
  using Quad = Channels<T, 4>;
  auto total = load<Quad>(sums);
#pragma GCC unroll 4
  for (Index l = 4; l < kSums<L>; l += 4) total += load<Quad>(sums + l);
  return total;
}

/// The best pair's channels of n pixels from column `begin` on at hypothesis d, from the pixels'
/// distances in `s.distances`, to planes at `out`. Which source is the best changes from pixel to
/// pixel as noise does, so nothing here branches on it.
template <class T>
void choose_pairs(const SweepRow<T>& s, Index begin, Index n, Index d, T* out) {
  constexpr Index kPart = kDistanceParts, L = kLanes<T>;
  static_assert(kPart + 1 == kPairChannels && kSweepTile % L == 0);
  using B = Batch<T>;
  // Of the best source so far, -1 for none. Whole vectors are worked on: what stands behind pixel n
  // is never read.
  alignas(B) T planes[kPart][kSweepTile] = {}, distance[kPart][kSweepTile] = {}, least[kSweepTile],
               counted[kSweepTile], best[kSweepTile];
  for (Index i = 0; i < kSweepTile; ++i) least[i] = counted[i] = 0, best[i] = -1;
  for (Index j = 0; j < s.J; ++j) {
    scatter_pixels<false>(s.distances + j * kSweepTile * kPart, n, kPart, kPart, planes[0],
                          kSweepTile);
    const B source(static_cast<T>(j));
    for (Index i = 0; i < n; i += L) {
      const B counts = B::load_unaligned(s.taps[j].counts + i), before = B::load_aligned(best + i),
              smallest = B::load_aligned(least + i);
      B of[kPart];
      for (Index k = 0; k < kPart; ++k) of[k] = B::load_aligned(planes[k] + i);
      const B total = (of[0] + of[1]) + (of[2] + of[3]);
      const auto better = (counts != B(T(0))) & ((before < B(T(0))) | (total < smallest));
      xsimd::select(better, total, smallest).store_aligned(least + i);
      xsimd::select(better, source, before).store_aligned(best + i);
      for (Index k = 0; k < kPart; ++k)
        xsimd::select(better, of[k], B::load_aligned(distance[k] + i))
            .store_aligned(distance[k] + i);
      (B::load_aligned(counted + i) + counts).store_aligned(counted + i);
    }
  }
  const Index step = s.D * s.plane;
  const T unit = T(4) / static_cast<T>(s.C), all = static_cast<T>(s.J > 0 ? s.J : 1);
  for (Index k = 0; k < kPart; ++k)
    for (Index i = 0; i < n; ++i) out[k * step + i] = distance[k][i] * unit;
  for (Index i = 0; i < n; ++i) out[kPart * step + i] = counted[i] / all;  // 0 of 0 are none
  std::int8_t* kept = s.best + d * s.H * s.W + begin;
  for (Index i = 0; i < n; ++i) kept[i] = static_cast<std::int8_t>(best[i]);
}

/// Variances of n pixels to `s.tile` and, for pairs, distances to all sources to `s.distances`.
template <class T, Index L, Index kJ, bool kPairs>
void forward_tile(const SweepRow<T>& row, Index begin, Index n) {
  using V = Channels<T, L>;
  constexpr Index kParts = kSums<L> / L;
  // A copy, which the stores below cannot change: of `row` all would be read again behind each.
  const SweepRow<T> s = row;
  const Sampler<T, L, kJ> sampler{s};
  const Index J = sampler.J;
  T shares[kSweepTile];
  sampler.shares(n, shares);
  V local[kJ > 0 ? kJ : 1];
  V* f = kJ > 0 ? local : reinterpret_cast<V*>(s.samples);
  V local_sums[(kJ > 0 ? kJ : 1) * kParts];
  V* sums = kJ > 0 ? local_sums : reinterpret_cast<V*>(s.sums);
  for (Index i = 0; i < n; ++i) {
    T* to = s.tile + i * s.Cs;
    const T share = shares[i];
    if (share == 0 && !kPairs) {
      fill_zero(to, s.Cs);
      continue;
    }
    if constexpr (kPairs)
      for (Index k = 0; k < J * kParts; ++k) sums[k] = V{};
    for (Index c = 0; c < s.Cs; c += L) {
      const V own = load<V>(s.reference + (begin + i) * s.Cs + c);
      const V mean = sampler.mean(i, c, own, share, f);
      V total = (own - mean) * (own - mean) * s.reference_counts;
      for (Index j = 0; j < J; ++j) total += (f[j] - mean) * (f[j] - mean) * s.taps[j].counts[i];
      store<V>(to + c, total * share);
      if constexpr (kPairs)
        for (Index j = 0; j < J; ++j)
          sums[j * kParts + c / L % kParts] += (own - f[j]) * (own - f[j]);
    }
    if constexpr (kPairs)
      for (Index j = 0; j < J; ++j) {
        const auto* of_source = reinterpret_cast<const T*>(sums + j * kParts);
        store(s.distances + (j * kSweepTile + i) * kDistanceParts, quarters<L>(of_source));
      }
  }
}

/// dV/df_j = 2 m_j (f_j - mean) / n; the mean's own derivative cancels.
template <class T, Index L, Index kJ, bool kPairs>
void backward_tile(const SweepRow<T>& s, Index begin, Index n, Index d, T* const* d_sources,
                   const std::int32_t* first_row) {
  using V = Channels<T, L>;
  const Sampler<T, L, kJ> sampler{s};
  const Index right = sampler.right, down = sampler.down;
  V local[kJ > 0 ? kJ : 1];
  V* f = kJ > 0 ? local : reinterpret_cast<V*>(s.samples);
  T shares[kSweepTile];
  sampler.shares(n, shares);
  for (Index i = 0; i < n; ++i) {
    const T share = shares[i];
    const Index best = kPairs ? s.best[d * s.H * s.W + begin + i] : -1;
    if (share == 0 && best < 0) continue;
    for (Index c = 0; c < s.Cs; c += L) {
      const V own = load<V>(s.reference + (begin + i) * s.Cs + c);
      const V mean = sampler.mean(i, c, own, share, f);
      const V g = load<V>(s.tile + i * s.Cs + c) * (2 * share);
      V d_own = g * (own - mean) * s.reference_counts, d_best{};
      if constexpr (kPairs)
        if (best >= 0) {  // d/df_ref of 4 / C (f_ref - f_b)^2, and the opposite for f_b
          T factor[L];
          const T* gp = s.pair_tile + i * kPairStride;
          for (Index l = 0; l < L; ++l) factor[l] = gp[(c + l) & 3] * (T(8) / static_cast<T>(s.C));
          d_best = load<V>(factor) * (f[best] - own);
          d_own -= d_best;
        }
      add_to<V>(s.reference_tile + i * s.Cs + c, d_own);
      for (Index j = 0; j < sampler.J; ++j) {
        const SweepTaps<T>& t = s.taps[j];
        if (t.counts[i] == 0) continue;
        V e = g * (f[j] - mean);
        if (kPairs && j == best) e += d_best;
        T* p = d_sources[j] + (sampler.offset(j, i) - first_row[j] * s.W * s.Cs + c);
        add_to<V>(p, e * t.weight[0][i]);
        add_to<V>(p + right, e * t.weight[1][i]);
        add_to<V>(p + down, e * t.weight[2][i]);
        add_to<V>(p + down + right, e * t.weight[3][i]);
      }
    }
  }
}

/// Calls body.template operator()<L, J, pairs>() for the widest L that divides Cs.
template <class T, Index kJ, bool kPairs, class Body>
void with_lanes(Index Cs, const Body& body) {
  constexpr Index kMost = kLanes<T>;
  if constexpr (kMost >= 16)
    if (Cs % 16 == 0) return body.template operator()<16, kJ, kPairs>();
  if constexpr (kMost >= 8)
    if (Cs % 8 == 0) return body.template operator()<8, kJ, kPairs>();
  body.template operator()<(kMost < 4 ? kMost : 4), kJ, kPairs>();
}

template <class T, bool kPairs, class Body>
void with_sources(const SweepRow<T>& s, const Body& body) {
  if (s.J == 2)
    with_lanes<T, 2, kPairs>(s.Cs, body);
  else if (s.J == 1)
    with_lanes<T, 1, kPairs>(s.Cs, body);
  else
    with_lanes<T, 0, kPairs>(s.Cs, body);
}

template <class T, class Body>
void with_shape(const SweepRow<T>& s, const Body& body) {
  if (s.best != nullptr)
    with_sources<T, true>(s, body);
  else
    with_sources<T, false>(s, body);
}

/// SweepKernels::forward's `touched` before the first samples, of those of n pixels, after the last.
template <class T>
void begin_touched(const SweepRow<T>& s, std::int32_t* touched) {
  for (Index j = 0; j < s.J; ++j) {
    touched[2 * j] = static_cast<std::int32_t>(s.H);
    touched[2 * j + 1] = -1;
  }
}
template <class T>
void add_touched(const SweepRow<T>& s, Index n, std::int32_t* touched) {
  for (Index j = 0; j < s.J; ++j) {
    std::int32_t low = touched[2 * j], high = touched[2 * j + 1];
    const SweepTaps<T>& t = s.taps[j];
    for (Index i = 0; i < n; ++i) {
      const std::int32_t first = t.counts[i] != 0 ? t.y[i] : low;
      const std::int32_t last = t.counts[i] != 0 ? t.y[i] : high;
      low = first < low ? first : low;
      high = last > high ? last : high;
    }
    touched[2 * j] = low;
    touched[2 * j + 1] = high;
  }
}
template <class T>
void end_touched(const SweepRow<T>& s, std::int32_t* touched) {
  for (Index j = 0; j < s.J; ++j)  // the lower neighbours
    if (touched[2 * j + 1] >= 0 && s.H > 1) ++touched[2 * j + 1];
}

template <class T>
void forward(const SweepRow<T>& s, T* out, std::int32_t* touched) {
  const Index P = s.plane;
  if (touched != nullptr) begin_touched(s, touched);
  for (Index begin = 0; begin < s.W; begin += kSweepTile) {
    const Index n = s.W - begin < kSweepTile ? s.W - begin : kSweepTile;
    for (Index j = 0; j < s.J; ++j) make_lines(s.maps[j], begin, n, s.lines[j]);
    for (Index d = 0; d < s.D; ++d) {
      make_all_taps(s, begin, n, d);
      if (touched != nullptr) add_touched(s, n, touched);
      with_shape(s, [&]<Index L, Index kJ, bool kPairs>() {
        forward_tile<T, L, kJ, kPairs>(s, begin, n);
      });
      scatter_pixels<false>(s.tile, n, s.C, s.Cs, out + d * P + begin, s.D * P);
      if (s.best != nullptr) choose_pairs(s, begin, n, d, out + (s.C * s.D + d) * P + begin);
    }
  }
  if (touched != nullptr) end_touched(s, touched);
}

template <class T>
void backward(const SweepRow<T>& s, const T* g, T* d_reference, T* const* d_sources,
              const std::int32_t* first_row) {
  const Index P = s.H * s.W;
  fill_zero(s.tile, kSweepTile * s.Cs);
  for (Index begin = 0; begin < s.W; begin += kSweepTile) {
    const Index n = s.W - begin < kSweepTile ? s.W - begin : kSweepTile;
    for (Index j = 0; j < s.J; ++j) make_lines(s.maps[j], begin, n, s.lines[j]);
    fill_zero(s.reference_tile, kSweepTile * s.Cs);
    for (Index d = 0; d < s.D; ++d) {
      make_all_taps(s, begin, n, d);
      gather_pixels(g + d * P + begin, s.D * P, n, s.C, s.Cs, s.tile);
      if (s.best != nullptr)
        gather_pixels(g + (s.C * s.D + d) * P + begin, s.D * P, n, kPairChannels, kPairStride,
                      s.pair_tile);
      with_shape(s, [&]<Index L, Index kJ, bool kPairs>() {
        backward_tile<T, L, kJ, kPairs>(s, begin, n, d, d_sources, first_row);
      });
    }
    scatter_pixels<true>(s.reference_tile, n, s.C, s.Cs, d_reference + begin, P);
  }
}

template <class T>
void to_pixels(const T* planes, Index plane_stride, Index W, Index C, Index Cs, T* pixels) {
  if (Cs > C) fill_zero(pixels, W * Cs);
  for (Index begin = 0; begin < W; begin += kSweepTile)
    gather_pixels(planes + begin, plane_stride, W - begin < kSweepTile ? W - begin : kSweepTile, C,
                  Cs, pixels + begin * Cs);
}

template <class T>
void add_rows(const T* const* rows, Index count, Index W, Index C, Index Cs, T* planes,
              Index plane_stride, T* tile) {
  for (Index begin = 0; begin < W; begin += kSweepTile) {
    const Index n = W - begin < kSweepTile ? W - begin : kSweepTile;
    fill_zero(tile, n * Cs);
    for (Index k = 0; k < count; ++k) {
      const T* row = rows[k] + begin * Cs;
      for (Index i = 0; i < n * Cs; ++i) tile[i] += row[i];
    }
    scatter_pixels<true>(tile, n, C, Cs, planes + begin, plane_stride);
  }
}

}  // namespace
}  // namespace satsurf::SATSURF_KERNEL_ISA

namespace satsurf {

template <class T>
template <Isa isa>
SweepKernels<T> SweepKernels<T>::compiled_for() {
  return {.forward = here::forward<T>,
          .backward = here::backward<T>,
          .to_pixels = here::to_pixels<T>,
          .add_rows = here::add_rows<T>};
}
template SweepKernels<float> SweepKernels<float>::compiled_for<kIsa>();
template SweepKernels<double> SweepKernels<double>::compiled_for<kIsa>();

}  // namespace satsurf

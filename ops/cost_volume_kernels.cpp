// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/cost_volume_kernels.h"

#include "satsurf/core/simd.h"

#include <type_traits>

namespace satsurf::SATSURF_ISA_NS {
namespace {

// The compiler's own vectors rather than Batch: eight channels are half a batch under AVX-512.
template <class T, Index L>
struct Lanes {
  typedef T Vec __attribute__((vector_size(L * sizeof(T))));
};
template <class T>
using Quad = typename Lanes<T, 4>::Vec;

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

template <class V>
void transpose(V& a, V& b, V& c, V& d) {
  const V ab_low = __builtin_shufflevector(a, b, 0, 4, 1, 5);
  const V ab_high = __builtin_shufflevector(a, b, 2, 6, 3, 7);
  const V cd_low = __builtin_shufflevector(c, d, 0, 4, 1, 5);
  const V cd_high = __builtin_shufflevector(c, d, 2, 6, 3, 7);
  a = __builtin_shufflevector(ab_low, cd_low, 0, 1, 4, 5);
  b = __builtin_shufflevector(ab_low, cd_low, 2, 3, 6, 7);
  c = __builtin_shufflevector(ab_high, cd_high, 0, 1, 4, 5);
  d = __builtin_shufflevector(ab_high, cd_high, 2, 3, 6, 7);
}

/// Planes [C n] to pixels [n Cs]; channels C.. are left alone.
template <class T>
void gather_pixels(const T* planes, Index stride, Index n, Index C, Index Cs, T* pixels) {
  using Q = Quad<T>;
  const Index whole_n = n / 4 * 4, whole_C = C / 4 * 4;
  for (Index c = 0; c < whole_C; c += 4) {
    const T* p = planes + c * stride;
    for (Index i = 0; i < whole_n; i += 4) {
      Q q0 = load<Q>(p + i), q1 = load<Q>(p + stride + i);
      Q q2 = load<Q>(p + 2 * stride + i), q3 = load<Q>(p + 3 * stride + i);
      transpose(q0, q1, q2, q3);
      T* to = pixels + i * Cs + c;
      store<Q>(to, q0);
      store<Q>(to + Cs, q1);
      store<Q>(to + 2 * Cs, q2);
      store<Q>(to + 3 * Cs, q3);
    }
    for (Index k = c; k < c + 4; ++k)
      for (Index i = whole_n; i < n; ++i) pixels[i * Cs + k] = planes[k * stride + i];
  }
  for (Index c = whole_C; c < C; ++c)
    for (Index i = 0; i < n; ++i) pixels[i * Cs + c] = planes[c * stride + i];
}

/// Pixels [n Cs] to planes [C n], stored or added.
template <bool kAdd, class T>
void scatter_pixels(const T* pixels, Index n, Index C, Index Cs, T* planes, Index stride) {
  using Q = Quad<T>;
  const auto put = [](T* to, const auto& value) {
    using V = std::decay_t<decltype(value)>;
    if constexpr (kAdd)
      add_to<V>(to, value);
    else
      store<V>(to, value);
  };
  const Index whole_n = n / 4 * 4, whole_C = C / 4 * 4;
  for (Index c = 0; c < whole_C; c += 4) {
    T* p = planes + c * stride;
    for (Index i = 0; i < whole_n; i += 4) {
      const T* from = pixels + i * Cs + c;
      Q q0 = load<Q>(from), q1 = load<Q>(from + Cs), q2 = load<Q>(from + 2 * Cs),
        q3 = load<Q>(from + 3 * Cs);
      transpose(q0, q1, q2, q3);
      put(p + i, q0);
      put(p + stride + i, q1);
      put(p + 2 * stride + i, q2);
      put(p + 3 * stride + i, q3);
    }
    for (Index k = c; k < c + 4; ++k)
      for (Index i = whole_n; i < n; ++i) put(planes + k * stride + i, pixels[i * Cs + k]);
  }
  for (Index c = whole_C; c < C; ++c)
    for (Index i = 0; i < n; ++i) put(planes + c * stride + i, pixels[i * Cs + c]);
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
    taps.nearest_x[i] = static_cast<std::int32_t>(u_in + T(0.5));
    taps.nearest_y[i] = static_cast<std::int32_t>(v_in + T(0.5));
    taps.counts[i] = counts;
    taps.weight[0][i] = counts * (1 - fx) * (1 - fy);
    taps.weight[1][i] = counts * fx * (1 - fy);
    taps.weight[2][i] = counts * (1 - fx) * fy;
    taps.weight[3][i] = counts * fx * fy;
  }
  if (valid == nullptr) return;
  for (Index i = 0; i < n; ++i) {
    if (valid[taps.nearest_y[i] * W + taps.nearest_x[i]] != 0) continue;
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
  using V = typename Lanes<T, L>::Vec;
  const SweepRow<T>& s;
  const Index J = kJ > 0 ? kJ : s.J;
  const Index right = s.W > 1 ? s.Cs : 0, down = s.H > 1 ? s.W *s.Cs : 0;

  T share(Index i) const {  // 1 / n, or 0 where the variance is 0 by definition
    T n = s.reference_counts;
    for (Index j = 0; j < J; ++j) n += s.taps[j].counts[i];
    return n >= 2 ? 1 / n : T(0);
  }
  Index offset(Index j, Index i) const {
    return (static_cast<Index>(s.taps[j].y[i]) * s.W + s.taps[j].x[i]) * s.Cs;
  }
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

template <class T, Index L, Index kJ>
void forward_tile(const SweepRow<T>& s, Index begin, Index n) {
  using V = typename Lanes<T, L>::Vec;
  const Sampler<T, L, kJ> sampler{s};
  V local[kJ > 0 ? kJ : 1];
  V* f = kJ > 0 ? local : reinterpret_cast<V*>(s.samples);
  for (Index i = 0; i < n; ++i) {
    T* to = s.tile + i * s.Cs;
    const T share = sampler.share(i);
    if (share == 0) {
      fill_zero(to, s.Cs);
      continue;
    }
    for (Index c = 0; c < s.Cs; c += L) {
      const V own = load<V>(s.reference + (begin + i) * s.Cs + c);
      const V mean = sampler.mean(i, c, own, share, f);
      V total = (own - mean) * (own - mean) * s.reference_counts;
      for (Index j = 0; j < sampler.J; ++j)
        total += (f[j] - mean) * (f[j] - mean) * s.taps[j].counts[i];
      store<V>(to + c, total * share);
    }
  }
}

/// dV/df_j = 2 m_j (f_j - mean) / n; the mean's own derivative cancels.
template <class T, Index L, Index kJ>
void backward_tile(const SweepRow<T>& s, Index begin, Index n, T* const* d_sources,
                   const std::int32_t* first_row) {
  using V = typename Lanes<T, L>::Vec;
  const Sampler<T, L, kJ> sampler{s};
  const Index right = sampler.right, down = sampler.down;
  V local[kJ > 0 ? kJ : 1];
  V* f = kJ > 0 ? local : reinterpret_cast<V*>(s.samples);
  for (Index i = 0; i < n; ++i) {
    const T share = sampler.share(i);
    if (share == 0) continue;
    for (Index c = 0; c < s.Cs; c += L) {
      const V own = load<V>(s.reference + (begin + i) * s.Cs + c);
      const V mean = sampler.mean(i, c, own, share, f);
      const V g = load<V>(s.tile + i * s.Cs + c) * (2 * share);
      add_to<V>(s.reference_tile + i * s.Cs + c, g * (own - mean) * s.reference_counts);
      for (Index j = 0; j < sampler.J; ++j) {
        const SweepTaps<T>& t = s.taps[j];
        if (t.counts[i] == 0) continue;
        const V e = g * (f[j] - mean);
        T* p = d_sources[j] + (sampler.offset(j, i) - first_row[j] * s.W * s.Cs + c);
        add_to<V>(p, e * t.weight[0][i]);
        add_to<V>(p + right, e * t.weight[1][i]);
        add_to<V>(p + down, e * t.weight[2][i]);
        add_to<V>(p + down + right, e * t.weight[3][i]);
      }
    }
  }
}

/// Calls body.template operator()<L, J>() for the widest L that divides Cs.
template <class T, Index kJ, class Body>
void with_lanes(Index Cs, const Body& body) {
  constexpr Index kMost = kLanes<T>;
  if constexpr (kMost >= 16)
    if (Cs % 16 == 0) return body.template operator()<16, kJ>();
  if constexpr (kMost >= 8)
    if (Cs % 8 == 0) return body.template operator()<8, kJ>();
  body.template operator()<(kMost < 4 ? kMost : 4), kJ>();
}

template <class T, class Body>
void with_shape(const SweepRow<T>& s, const Body& body) {
  if (s.J == 2)
    with_lanes<T, 2>(s.Cs, body);
  else if (s.J == 1)
    with_lanes<T, 1>(s.Cs, body);
  else
    with_lanes<T, 0>(s.Cs, body);
}

}  // namespace

template <class T>
void sweep_forward(const SweepRow<T>& s, T* out, std::int32_t* touched) {
  const Index P = s.H * s.W;
  for (Index j = 0; j < s.J; ++j) {
    touched[2 * j] = static_cast<std::int32_t>(s.H);
    touched[2 * j + 1] = -1;
  }
  for (Index begin = 0; begin < s.W; begin += kSweepTile) {
    const Index n = s.W - begin < kSweepTile ? s.W - begin : kSweepTile;
    for (Index j = 0; j < s.J; ++j) make_lines(s.maps[j], begin, n, s.lines[j]);
    for (Index d = 0; d < s.D; ++d) {
      make_all_taps(s, begin, n, d);
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
      with_shape(s, [&]<Index L, Index kJ>() { forward_tile<T, L, kJ>(s, begin, n); });
      scatter_pixels<false>(s.tile, n, s.C, s.Cs, out + d * P + begin, s.D * P);
    }
  }
  for (Index j = 0; j < s.J; ++j)  // the lower neighbours
    if (touched[2 * j + 1] >= 0 && s.H > 1) ++touched[2 * j + 1];
}

template <class T>
void sweep_backward(const SweepRow<T>& s, const T* g, T* d_reference, T* const* d_sources,
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
      with_shape(s, [&]<Index L, Index kJ>() {
        backward_tile<T, L, kJ>(s, begin, n, d_sources, first_row);
      });
    }
    scatter_pixels<true>(s.reference_tile, n, s.C, s.Cs, d_reference + begin, P);
  }
}

template <class T>
void sweep_to_pixels(const T* planes, Index plane_stride, Index W, Index C, Index Cs, T* pixels) {
  if (Cs > C) fill_zero(pixels, W * Cs);
  for (Index begin = 0; begin < W; begin += kSweepTile)
    gather_pixels(planes + begin, plane_stride, W - begin < kSweepTile ? W - begin : kSweepTile, C,
                  Cs, pixels + begin * Cs);
}

template <class T>
void sweep_add_rows(const T* const* rows, Index count, Index W, Index C, Index Cs, T* planes,
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

template void sweep_forward(const SweepRow<float>&, float*, std::int32_t*);
template void sweep_forward(const SweepRow<double>&, double*, std::int32_t*);
template void sweep_backward(const SweepRow<float>&, const float*, float*, float* const*,
                             const std::int32_t*);
template void sweep_backward(const SweepRow<double>&, const double*, double*, double* const*,
                             const std::int32_t*);
template void sweep_to_pixels(const float*, Index, Index, Index, Index, float*);
template void sweep_to_pixels(const double*, Index, Index, Index, Index, double*);
template void sweep_add_rows(const float* const*, Index, Index, Index, Index, float*, Index,
                             float*);
template void sweep_add_rows(const double* const*, Index, Index, Index, Index, double*, Index,
                             double*);

}  // namespace satsurf::SATSURF_ISA_NS

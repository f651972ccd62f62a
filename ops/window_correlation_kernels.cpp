// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/window_correlation_kernels.h"

#include "satsurf/core/simd.h"

#include <cmath>
#include <cstdint>

namespace satsurf::SATSURF_KERNEL_ISA {
namespace {

constexpr Index kTile = 64;  // pixels worked on together: their places stay in the nearest cache

/// Where the pixels of a tile lie in the other image: the upper left of four neighbours, which always
/// is in the image, shares of the others, and 1 where the place is in the image.
template <class T>
struct Places {
  std::int32_t at[kTile];
  T fx[kTile], fy[kTile], counts[kTile];
};

/// returns  how many lie in the image
template <class T>
T find_places(const WarpedRow<T>& row, Index begin, Index n, Places<T>& to) {
  const T right = static_cast<T>(row.W - 1), bottom = static_cast<T>(row.H - 1);
  const auto last_x = static_cast<std::int32_t>(row.W > 1 ? row.W - 2 : 0),
             last_y = static_cast<std::int32_t>(row.H > 1 ? row.H - 2 : 0),
             stride = static_cast<std::int32_t>(row.W);
  // Along a tile in T: from its first pixel on, a place moves by some hundred pixels at most.
  const double t = row.t0 + static_cast<double>(begin) * row.step;
  const T u0 = static_cast<T>(row.u[0] + t * (row.u[1] + t * row.u[2])),
          u1 = static_cast<T>(row.step * (row.u[1] + 2 * t * row.u[2])),
          u2 = static_cast<T>(row.step * row.step * row.u[2]),
          v0 = static_cast<T>(row.v[0] + t * (row.v[1] + t * row.v[2])),
          v1 = static_cast<T>(row.step * (row.v[1] + 2 * t * row.v[2])),
          v2 = static_cast<T>(row.step * row.step * row.v[2]);
  T inside = 0;
  for (Index i = 0; i < n; ++i) {
    const T k = static_cast<T>(static_cast<std::int32_t>(i));
    const T u = u0 + k * (u1 + k * u2), v = v0 + k * (v1 + k * v2);
    const T u_up = u > 0 ? u : T(0), v_up = v > 0 ? v : T(0);
    const T u_in = u_up < right ? u_up : right, v_in = v_up < bottom ? v_up : bottom;
    const auto floor_x = static_cast<std::int32_t>(u_in), floor_y = static_cast<std::int32_t>(v_in);
    const std::int32_t x = floor_x < last_x ? floor_x : last_x,
                       y = floor_y < last_y ? floor_y : last_y;
    const T counts = (u_in == u ? T(1) : T(0)) * (v_in == v ? T(1) : T(0));
    to.at[i] = y * stride + x;
    to.fx[i] = u_in - static_cast<T>(x);
    to.fy[i] = v_in - static_cast<T>(y);
    to.counts[i] = counts;
    inside += counts;
  }
  return inside;
}

template <class T>
Index products(const WarpedRow<T>& row, T* out) {
  const Index right = row.W > 1 ? 1 : 0, down = row.H > 1 ? row.W : 0;
  const T *b = row.b, *b_valid = row.b_valid;
  T *one = out, *a1 = out + row.n, *b1 = out + 2 * row.n, *aa = out + 3 * row.n,
    *bb = out + 4 * row.n, *ab = out + 5 * row.n;
  Places<T> places;
  T seen = 0;
  for (Index begin = 0; begin < row.n; begin += kTile) {
    const Index n = row.n - begin < kTile ? row.n - begin : kTile;
    if (find_places(row, begin, n, places) == 0) {
      for (Index k = 0; k < kWindowSums; ++k)
        for (Index i = 0; i < n; ++i) out[k * row.n + begin + i] = 0;
      continue;
    }
    const T *a = row.a + begin, *a_valid = row.a_valid + begin;
#pragma GCC ivdep
    for (Index i = 0; i < n; ++i) {
      const T* p = b + places.at[i];
      const T fx = places.fx[i], fy = places.fy[i];
      const T w = (a_valid[i] < 1 ? T(0) : T(1)) * (b_valid[places.at[i]] < 1 ? T(0) : T(1)) *
                  places.counts[i];
      const T vb = w * ((1 - fy) * ((1 - fx) * p[0] + fx * p[right]) +
                        fy * ((1 - fx) * p[down] + fx * p[down + right])),
              va = w * a[i];
      one[begin + i] = w;
      a1[begin + i] = va;
      b1[begin + i] = vb;
      aa[begin + i] = va * va;
      bb[begin + i] = vb * vb;
      ab[begin + i] = va * vb;
      seen += w;
    }
  }
  return static_cast<Index>(seen);
}

template <class T>
void add_up(const T* const* terms, Index n, T* __restrict__ out) {
  static_assert(kWindowSide == 7);
  const T *a = terms[0], *b = terms[1], *c = terms[2], *d = terms[3], *e = terms[4], *f = terms[5],
          *g = terms[6];
  for (Index i = 0; i < n; ++i) out[i] = ((a[i] + b[i]) + (c[i] + d[i])) + ((e[i] + f[i]) + g[i]);
}

/// Without a branch, so that it works on several windows at once.
template <class T>
void correlate(const T* const* rows, Index n, T* columns, T* sums, T* __restrict__ out) {
  const T* terms[kWindowSide];
  for (Index c = 0; c < kWindowSums; ++c) {
    for (Index k = 0; k < kWindowSide; ++k) terms[k] = rows[k] + c * n;
    add_up(terms, n, columns + ComparedWindow::kRadius);
    for (Index k = 0; k < kWindowSide; ++k) terms[k] = columns + k;
    add_up(terms, n, sums + c * n);
  }
  constexpr T whole = static_cast<T>(ComparedWindow::kWhole),
              texture = static_cast<T>(ComparedWindow::kTexture);
  const T *seen = sums, *a = sums + n, *b = sums + 2 * n, *aa = sums + 3 * n, *bb = sums + 4 * n,
          *ab = sums + 5 * n;
  for (Index x = 0; x < n; ++x) {
    const T m = seen[x] > 1 ? seen[x] : T(1), share = 1 / m, ma = a[x] * share, mb = b[x] * share,
            va = aa[x] * share - ma * ma, vb = bb[x] * share - mb * mb,
            da = va > texture ? va : texture, db = vb > texture ? vb : texture,
            r = (ab[x] * share - ma * mb) / std::sqrt(da * db);
    const T least = va < vb ? va : vb, known = least < texture ? T(-1) : r;
    out[x] = m < whole ? T(-1) : known;
  }
}

/// Of kBatches whole batches of windows; their sums stay in registers.
template <Index kBatches, class T>
void window_products(const T* weights, Index side, const T* image, Index stride, T* out) {
  Batch<T> sums[kBatches];
  for (Batch<T>& sum : sums) sum = Batch<T>(T(0));
  for (Index v = 0; v < side; ++v)
    for (Index u = 0; u < side; ++u) {
      const Batch<T> w(weights[v * side + u]);
      const T* p = image + v * stride + u;
#pragma GCC unroll 4
      for (Index k = 0; k < kBatches; ++k)
        sums[k] = xsimd::fma(w, Batch<T>::load_unaligned(p + k * kLanes<T>), sums[k]);
    }
  for (Index k = 0; k < kBatches; ++k) sums[k].store_unaligned(out + k * kLanes<T>);
}

template <class T>
void all_window_products(const T* weights, Index side, const T* image, Index stride, Index count,
                         T* out) {
  constexpr Index L = kLanes<T>, kBlock = 4 * L;
  Index k = 0;
  for (; k + kBlock <= count; k += kBlock)
    window_products<4>(weights, side, image + k, stride, out + k);
  for (; k + L <= count; k += L) window_products<1>(weights, side, image + k, stride, out + k);
  if (k == count) return;
  if (count >= L) {  // the last ones, some of them again
    window_products<1>(weights, side, image + count - L, stride, out + count - L);
    return;
  }
  for (Index i = 0; i < count; ++i) out[i] = 0;
  for (Index v = 0; v < side; ++v)
    for (Index u = 0; u < side; ++u)
      for (Index i = 0; i < count; ++i) out[i] += weights[v * side + u] * image[v * stride + u + i];
}

}  // namespace
}  // namespace satsurf::SATSURF_KERNEL_ISA

namespace satsurf {

template <class T>
template <Isa isa>
WindowCorrelationKernels<T> WindowCorrelationKernels<T>::compiled_for() {
  return {.products = here::products<T>,
          .correlate = here::correlate<T>,
          .window_products = here::all_window_products<T>};
}
template WindowCorrelationKernels<float> WindowCorrelationKernels<float>::compiled_for<kIsa>();
template WindowCorrelationKernels<double> WindowCorrelationKernels<double>::compiled_for<kIsa>();

}  // namespace satsurf

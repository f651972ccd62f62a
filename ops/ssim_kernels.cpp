// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/ssim_kernels.h"

#include "satsurf/ops/batch_kernels.h"

namespace satsurf::SATSURF_KERNEL_ISA {
namespace {

constexpr Index R = kSsimRadius;

/// sum += weight (a c + b d); equal for (a, a), (b, b) and for (a, c), (b, d) with a = c, b = d, so
/// that an image is exactly as similar to itself as can be.
template <class T>
Batch<T> pair_product(T weight, const Batch<T>& a, const Batch<T>& c, const Batch<T>& b,
                      const Batch<T>& d, const Batch<T>& sum) {
  return xsimd::fma(Batch<T>(weight), xsimd::fma(a, c, b * d), sum);
}

template <class T>
void moments(const SsimTerms<T>& terms, const T* const* x, const T* const* y, Index n,
             T* const* filtered) {
  const T* const w = terms.window;
  each_batch<T>(n, [&](Index i, Index k) {
    const Batch<T> cx = load(x[R] + i, k), cy = load(y[R] + i, k);
    Batch<T> mx = w[0] * cx, my = w[0] * cy;
    Batch<T> xx = w[0] * (cx * cx), yy = w[0] * (cy * cy), xy = w[0] * (cx * cy);
#pragma GCC unroll 5
    for (Index r = 1; r <= R; ++r) {
      const Batch<T> ax = load(x[R - r] + i, k), bx = load(x[R + r] + i, k);
      const Batch<T> ay = load(y[R - r] + i, k), by = load(y[R + r] + i, k);
      mx = xsimd::fma(Batch<T>(w[r]), ax + bx, mx);
      my = xsimd::fma(Batch<T>(w[r]), ay + by, my);
      xx = pair_product(w[r], ax, ax, bx, bx, xx);
      yy = pair_product(w[r], ay, ay, by, by, yy);
      xy = pair_product(w[r], ax, ay, bx, by, xy);
    }
    store(filtered[0] + i, mx, k);
    store(filtered[1] + i, my, k);
    store(filtered[2] + i, xx, k);
    store(filtered[3] + i, yy, k);
    store(filtered[4] + i, xy, k);
  });
}

/// The window's weighted sum around the elements from `at` on.
template <class T>
Batch<T> across(const SsimTerms<T>& terms, const T* at) {
  Batch<T> sum = terms.window[0] * Batch<T>::load_unaligned(at);
#pragma GCC unroll 5
  for (Index r = 1; r <= R; ++r)
    sum = xsimd::fma(Batch<T>(terms.window[r]),
                     Batch<T>::load_unaligned(at - r) + Batch<T>::load_unaligned(at + r), sum);
  return sum;
}

template <class T>
void compare(const SsimTerms<T>& terms, const T* const* filtered, const T* counts, Index n,
             T* const* slopes, double* sums) {
  const Batch<T> zero(T(0)), one(T(1)), scale(terms.covariance), c1(terms.c1), c2(terms.c2);
  PairSum<T> total;
  each_batch<T>(n, [&](Index i, Index k) {
    const Batch<T> mx = across(terms, filtered[0] + i), my = across(terms, filtered[1] + i);
    const Batch<T> xx = across(terms, filtered[2] + i), yy = across(terms, filtered[3] + i);
    const Batch<T> xy = across(terms, filtered[4] + i);
    // Above and below alike, each product rounded or not as the other: of an image and itself they are
    // equal.
    const Batch<T> vx = xsimd::fnma(mx, mx, xx), vy = xsimd::fnma(my, my, yy),
                   cov = xsimd::fnma(mx, my, xy);
    const Batch<T> a1 = xsimd::fma(mx, my, mx * my) + c1, b1 = xsimd::fma(mx, mx, my * my) + c1;
    const Batch<T> a2 = xsimd::fma(scale, cov, scale * cov) + c2,
                   b2 = xsimd::fma(scale, vx, scale * vy) + c2;
    const Batch<T> below = b1 * b2, similar = (a1 * a2) / below;
    const auto in = load(counts + i, k) != zero;
    total.add(xsimd::select(in, similar, zero), xsimd::select(in, one, zero));
    if (slopes == nullptr) return;
    const Batch<T> inverse = one / below, twice = inverse + inverse;
    const Batch<T> by_xy = scale * a1 * twice;
    const Batch<T> by_xx = -scale * similar * b1 * inverse;
    const Batch<T> by_mean = my * a2 * twice - mx * similar * b2 * twice;
    const Batch<T> by_x = by_mean - my * by_xy - T(2) * mx * by_xx;
    store(slopes[0] + i, xsimd::select(in, by_x, zero), k);
    store(slopes[1] + i, xsimd::select(in, by_xx, zero), k);
    store(slopes[2] + i, xsimd::select(in, by_xy, zero), k);
  });
  total.result(sums);
}

template <class T>
void down(const SsimTerms<T>& terms, const T* const* rows, Index n, T* filtered) {
  each_batch<T>(n, [&](Index i, Index k) {
    Batch<T> sum = terms.window[0] * load(rows[R] + i, k);
#pragma GCC unroll 5
    for (Index r = 1; r <= R; ++r)
      sum = xsimd::fma(Batch<T>(terms.window[r]),
                       load(rows[R - r] + i, k) + load(rows[R + r] + i, k), sum);
    store(filtered + i, sum, k);
  });
}

template <class T>
void gather(const SsimTerms<T>& terms, const T* const* filtered, const T* x, const T* y,
            const T* counts, T factor, Index n, T* d) {
  const Batch<T> zero(T(0)), scale(factor);
  each_batch<T>(n, [&](Index i, Index k) {
    const Batch<T> by_x = across(terms, filtered[0] + i), by_xx = across(terms, filtered[1] + i);
    const Batch<T> by_xy = across(terms, filtered[2] + i), px = load(x + i, k);
    const Batch<T> slope = xsimd::fma(px + px, by_xx, xsimd::fma(load(y + i, k), by_xy, by_x));
    const Batch<T> add = xsimd::select(load(counts + i, k) != zero, scale * slope, zero);
    store(d + i, load(d + i, k) + add, k);
  });
}

}  // namespace

}  // namespace satsurf::SATSURF_KERNEL_ISA

namespace satsurf {

template <class T>
template <Isa isa>
SsimKernels<T> SsimKernels<T>::compiled_for() {
  return {.moments = here::moments<T>,
          .compare = here::compare<T>,
          .down = here::down<T>,
          .gather = here::gather<T>};
}
template SsimKernels<float> SsimKernels<float>::compiled_for<kIsa>();
template SsimKernels<double> SsimKernels<double>::compiled_for<kIsa>();

}  // namespace satsurf

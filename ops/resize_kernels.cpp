// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/resize_kernels.h"

#include "satsurf/ops/batch_kernels.h"

namespace satsurf::SATSURF_KERNEL_ISA {
namespace {

/// Stores even and odd elements in turn.
template <class T>
void store_pairs(const Batch<T>& even, const Batch<T>& odd, T* to) {
  interleave_low(even, odd).store_unaligned(to);
  interleave_high(even, odd).store_unaligned(to + kLanes<T>);
}

/// The elements at even places and those at odd places of 2 L in a row.
template <class T>
struct Pairs {
  Batch<T> at_even, at_odd;

  explicit Pairs(const T* p) {
    const auto a = Batch<T>::load_unaligned(p), b = Batch<T>::load_unaligned(p + kLanes<T>);
    at_even = even(a, b);
    at_odd = odd(a, b);
  }
};

/// Rows are too short for the processor to fetch ahead by itself; 8 kB on lie those of the next
/// calls.
template <class T>
constexpr Index kAhead = 8192 / sizeof(T);

/// R rows at a time, the first of all written and the others added.
template <class T, Index R>
void mix_rows(bool first, const T* const* rows, const T* weight, Index n, T* y) {
  each_batch<T>(n, [=](Index i, Index k) {
    Batch<T> sum(T(0));
#pragma GCC unroll 4
    for (Index r = 0; r < R; ++r) {
      __builtin_prefetch(rows[r] + i + kAhead<T>);
      sum = xsimd::fma(Batch<T>(weight[r]), load(rows[r] + i, k), sum);
    }
    store(y + i, first ? sum : sum + load(y + i, k), k);
  });
}

template <class T>
void mix(Index count, const T* const* rows, const T* weight, Index n, T* y) {
  Index r = 0;
  for (; r + 4 <= count; r += 4) mix_rows<T, 4>(r == 0, rows + r, weight + r, n, y);
  for (; r + 2 <= count; r += 2) mix_rows<T, 2>(r == 0, rows + r, weight + r, n, y);
  for (; r < count; ++r) mix_rows<T, 1>(r == 0, rows + r, weight + r, n, y);
}

template <class T>
void between(Index n, const T* a, const T* b, T weight, T* y) {
  each_batch<T>(n, [=](Index i, Index k) {
    const Batch<T> from = load(a + i, k);
    store(y + i, xsimd::fma(Batch<T>(weight), load(b + i, k) - from, from), k);
  });
}

template <class T>
void scaled(Index n, const T* x, T scale, bool accumulate, T* d) {
  each_batch<T>(n, [=](Index i, Index k) {
    const Batch<T> v = load(x + i, k);
    store(d + i, accumulate ? xsimd::fma(Batch<T>(scale), v, load(d + i, k)) : scale * v, k);
  });
}

template <class T>
void repeat(Index n, const T* x, T* y) {
  constexpr Index L = kLanes<T>;
  Index i = 0;
  for (; i + L <= n; i += L) {
    const auto v = Batch<T>::load_unaligned(x + i);
    store_pairs(v, v, y + 2 * i);
  }
  for (; i < n; ++i) y[2 * i] = y[2 * i + 1] = x[i];
}

template <class T>
void pair_sums(Index n, const T* x, T scale, bool accumulate, T* y) {
  constexpr Index L = kLanes<T>;
  Index i = 0;
  for (; i + L <= n; i += L) {
    const Pairs<T> at(x + 2 * i);
    Batch<T> sum = scale * (at.at_even + at.at_odd);
    if (accumulate) sum += Batch<T>::load_unaligned(y + i);
    sum.store_unaligned(y + i);
  }
  for (; i < n; ++i) y[i] = (accumulate ? y[i] : T(0)) + scale * (x[2 * i] + x[2 * i + 1]);
}

template <class T>
void expand(Index n, const T* x, T* y) {
  constexpr Index L = kLanes<T>;
  Index i = 0;
  for (; i + L <= n; i += L) {
    const auto near = Batch<T>::load_unaligned(x + i);
    const auto side = [&](Index step) {  // exact where the two are equal
      return xsimd::fma(Batch<T>(T(0.25)), Batch<T>::load_unaligned(x + i + step) - near, near);
    };
    store_pairs(side(-1), side(1), y + 2 * i);
  }
  for (; i < n; ++i) {
    y[2 * i] = x[i] + T(0.25) * (x[i - 1] - x[i]);
    y[2 * i + 1] = x[i] + T(0.25) * (x[i + 1] - x[i]);
  }
}

template <class T>
void expand_backward(Index n, const T* g, bool accumulate, T* d) {
  constexpr Index L = kLanes<T>;
  Index i = 0;
  for (; i + L <= n; i += L) {
    // g[2 i - 1] and g[2 i], then g[2 i + 1] and g[2 i + 2]
    const Pairs<T> before(g + 2 * i - 1), behind(g + 2 * i + 1);
    const Batch<T> near = before.at_odd + behind.at_even, far = before.at_even + behind.at_odd;
    Batch<T> sum = xsimd::fma(Batch<T>(T(0.75)), near, T(0.25) * far);
    if (accumulate) sum += Batch<T>::load_unaligned(d + i);
    sum.store_unaligned(d + i);
  }
  for (; i < n; ++i)
    d[i] = (accumulate ? d[i] : T(0)) + T(0.75) * (g[2 * i] + g[2 * i + 1]) +
           T(0.25) * (g[2 * i - 1] + g[2 * i + 2]);
}

}  // namespace

}  // namespace satsurf::SATSURF_KERNEL_ISA

namespace satsurf {

template <class T>
template <Isa isa>
ResizeKernels<T> ResizeKernels<T>::compiled_for() {
  return {.mix = here::mix<T>,
          .between = here::between<T>,
          .scaled = here::scaled<T>,
          .repeat = here::repeat<T>,
          .pair_sums = here::pair_sums<T>,
          .expand = here::expand<T>,
          .expand_backward = here::expand_backward<T>};
}
template ResizeKernels<float> ResizeKernels<float>::compiled_for<kIsa>();
template ResizeKernels<double> ResizeKernels<double>::compiled_for<kIsa>();

}  // namespace satsurf

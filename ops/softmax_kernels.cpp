// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/softmax_kernels.h"

#include "satsurf/ops/batch_kernels.h"

namespace satsurf::SATSURF_KERNEL_ISA {
namespace {

constexpr Index S = kSoftmaxRow;

/// Planes worked on together.
template <Index N>
struct Planes {
  static constexpr Index kCount = N;
};

/// body(planes, first plane): four at a time, because what is kept per pixel is then read
/// and written a quarter as often.
template <class Body>
void each_group(Index D, const Body& body) {
  constexpr Index kGroup = 4;
  Index d = 0;
  for (; d + kGroup <= D; d += kGroup) body(Planes<kGroup>{}, d);
  for (; d < D; ++d) body(Planes<1>{}, d);
}

template <class T>
void fill_row(Index n, T value, T* row) {
  for (Index i = 0; i < n; i += kLanes<T>) Batch<T>(value).store_unaligned(row + i);
}

template <class T, bool kHeights>
void forward(Index D, Index stride, Index n, const T* x, const T* z, T* y, T* height, T* confidence,
             T* tile) {
  T *top = tile + D * S, *total = top + S, *mean = total + S;
  fill_row(n, T(0), total);
  if constexpr (kHeights) fill_row(n, T(0), mean);
  const auto row = [](const T* p) { return Batch<T>::load_unaligned(p); };
  // The tile is contiguous; the planes are often a power of two apart and would evict each other.
  each_group(D, [&](auto planes, Index d) {
    constexpr Index R = planes.kCount;
    const T* from = x + d * stride;
    T* to = tile + d * S;
    each_batch<T>(n, [&](Index i, Index k) {
      Batch<T> most = d == 0 ? load(from + i, k) : row(top + i);
#pragma GCC unroll 4
      for (Index r = 0; r < R; ++r) {
        const Batch<T> v = load(from + r * stride + i, k);
        v.store_unaligned(to + r * S + i);
        most = xsimd::max(most, v);
      }
      most.store_unaligned(top + i);
    });
  });
  each_group(D, [&](auto planes, Index d) {
    constexpr Index R = planes.kCount;
    T* of = tile + d * S;
    each_batch<T>(n, [&](Index i, Index k) {
      Batch<T> sum = row(total + i), weighted(T(0));
      if constexpr (kHeights) weighted = row(mean + i);
#pragma GCC unroll 4
      for (Index r = 0; r < R; ++r) {
        const Batch<T> e = exp_below(row(of + r * S + i) - row(top + i));
        e.store_unaligned(of + r * S + i);
        // the exponentials leave time to ask for what is written, and read, after them
        __builtin_prefetch(y + (d + r) * stride + i, 1);
        __builtin_prefetch(x + (d + r) * stride + i + kSoftmaxPixels);
        sum += e;
        if constexpr (kHeights)
          weighted = xsimd::fma(e, load(z + (d + r) * stride + i, k), weighted);
      }
      sum.store_unaligned(total + i);
      if constexpr (kHeights) weighted.store_unaligned(mean + i);
    });
  });
  each_batch<T>(n, [&](Index i, Index k) {
    const Batch<T> share = T(1) / row(total + i);
    share.store_unaligned(total + i);
    if constexpr (kHeights) {
      store(height + i, row(mean + i) * share, k);
      store(confidence + i, share, k);  // the largest exponential is exactly 1
    }
  });
  each_group(D, [&](auto planes, Index d) {
    constexpr Index R = planes.kCount;
    each_batch<T>(n, [&](Index i, Index k) {
      const Batch<T> share = row(total + i);
#pragma GCC unroll 4
      for (Index r = 0; r < R; ++r)
        store(y + (d + r) * stride + i, row(tile + (d + r) * S + i) * share, k);
    });
  });
}

template <class T>
void forward(Index D, Index stride, Index n, const T* x, const T* z, T* y, T* height, T* confidence,
             T* tile) {
  if (z == nullptr)
    forward<T, false>(D, stride, n, x, z, y, height, confidence, tile);
  else
    forward<T, true>(D, stride, n, x, z, y, height, confidence, tile);
}

template <class T, bool kProbability, bool kHeights>
void backward(Index D, Index stride, Index n, const SoftmaxGradient<T>& of, T* tile) {
  T *mean = tile, *left = tile + S;  // left: the confidence's gradient until it is given away
  const auto row = [](const T* p) { return Batch<T>::load_unaligned(p); };
  const Batch<T> zero(T(0));
  each_batch<T>(n, [&](Index i, Index k) {
    Batch<T> all = zero;
    if constexpr (kHeights) {
      const Batch<T> g = load(of.g_confidence + i, k);
      g.store_unaligned(left + i);
      all = g * load(of.confidence + i, k);
    }
    all.store_unaligned(mean + i);
  });
  if constexpr (kProbability)
    each_group(D, [&](auto planes, Index d) {
      constexpr Index R = planes.kCount;
      const Index first = d * stride;
      each_batch<T>(n, [&](Index i, Index k) {
        Batch<T> all = row(mean + i);
#pragma GCC unroll 4
        for (Index r = 0; r < R; ++r) {
          const Index at = first + r * stride + i;
          all = xsimd::fma(load(of.p + at, k), load(of.g + at, k), all);
        }
        all.store_unaligned(mean + i);
      });
    });
  each_group(D, [&](auto planes, Index d) {
    constexpr Index R = planes.kCount;
    const Index first = d * stride;
    each_batch<T>(n, [&](Index i, Index k) {
      const Batch<T> all = row(mean + i);
      Batch<T> rest = zero, height = zero, top = zero, slope = zero;
      if constexpr (kHeights) {
        rest = row(left + i);
        height = load(of.height + i, k);
        top = load(of.confidence + i, k);
        slope = load(of.g_height + i, k);
      }
#pragma GCC unroll 4
      for (Index r = 0; r < R; ++r) {
        const Index at = first + r * stride + i;
        const Batch<T> p = load(of.p + at, k);
        Batch<T> e = -all;
        if constexpr (kProbability) e += load(of.g + at, k);
        if constexpr (kHeights) {
          e = xsimd::fma(slope, load(of.z + at, k) - height, e);
          const auto found = p == top;
          e += xsimd::select(found, rest, zero);
          rest = xsimd::select(found, zero, rest);
        }
        store(of.d + at, of.accumulate ? xsimd::fma(p, e, load(of.d + at, k)) : p * e, k);
      }
      if constexpr (kHeights) rest.store_unaligned(left + i);
    });
  });
}

template <class T>
void backward(Index D, Index stride, Index n, const SoftmaxGradient<T>& of, T* tile) {
  if (of.z == nullptr)
    backward<T, true, false>(D, stride, n, of, tile);
  else if (of.g == nullptr)
    backward<T, false, true>(D, stride, n, of, tile);
  else
    backward<T, true, true>(D, stride, n, of, tile);
}

}  // namespace

}  // namespace satsurf::SATSURF_KERNEL_ISA

namespace satsurf {

template <class T>
template <Isa isa>
SoftmaxKernels<T> SoftmaxKernels<T>::compiled_for() {
  return {.forward = here::forward<T>, .backward = here::backward<T>};
}
template SoftmaxKernels<float> SoftmaxKernels<float>::compiled_for<kIsa>();
template SoftmaxKernels<double> SoftmaxKernels<double>::compiled_for<kIsa>();

}  // namespace satsurf

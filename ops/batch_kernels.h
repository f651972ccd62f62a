// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/simd.h"

#include <cstdint>

/// What kernel sources (core/isa.h) share beyond core/simd.h: loops in whole batches with a tail,
/// and sums that go to double.
namespace satsurf::SATSURF_KERNEL_ISA {

/// body(at, lanes) for whole batches, then once for what is left over; it loads and stores through
/// the two functions below, which touch `lanes` elements only.
template <class T, class Body>
void each_batch(Index n, const Body& body) {
  constexpr Index L = kLanes<T>;
  Index i = 0;
  for (; i + L <= n; i += L) body(i, L);
  if (i < n) body(i, n - i);
}

/// Lanes beyond `lanes` become 0.
template <class T>
Batch<T> load(const T* p, Index lanes) {
  if (lanes == kLanes<T>) return Batch<T>::load_unaligned(p);
  alignas(Batch<T>) T whole[kLanes<T>] = {};
  for (Index k = 0; k < lanes; ++k) whole[k] = p[k];
  return Batch<T>::load_aligned(whole);
}
template <class T>
void store(T* p, const Batch<T>& v, Index lanes) {
  if (lanes == kLanes<T>) return v.store_unaligned(p);
  alignas(Batch<T>) T whole[kLanes<T>];
  v.store_aligned(whole);
  for (Index k = 0; k < lanes; ++k) p[k] = whole[k];
}

/// exp(x) for x <= 0, exactly 1 at 0.
inline Batch<double> exp_below(const Batch<double>& x) { return xsimd::exp(x); }
inline Batch<float> exp_below(const Batch<float>& x) {
  // 2^k exp(r), k = round(x / ln 2). Adding 1.5 2^23 rounds and leaves k in the lowest bits.
  constexpr float kRound = 12582912.0f;
  const Batch<float> shifted = xsimd::fma(x, Batch<float>(1.44269504f), Batch<float>(kRound));
  const Batch<float> k = shifted - kRound;
  const Batch<float> r =
      xsimd::fnma(k, Batch<float>(-2.12194440e-4f), xsimd::fnma(k, Batch<float>(0.693359375f), x));
  // Chebyshev fit of (exp(r) - 1 - r) / r^2 for |r| <= ln(2) / 2, error of the result 1e-8
  const float c[] = {0.00836317334f, 0.0416665561f, 0.166665778f, 0.5f, 1.0f, 1.0f};
  Batch<float> series(0.00139261759f);
  for (const float of : c) series = xsimd::fma(series, r, Batch<float>(of));
  using Bits = xsimd::batch<std::int32_t, Batch<float>::arch_type>;
  const Bits power = xsimd::bitwise_cast<Bits>(shifted) << 23;  // added to the exponent
  series = xsimd::bitwise_cast<Batch<float>>(xsimd::bitwise_cast<Bits>(series) + power);
  return xsimd::select(x < -87.33f, Batch<float>(0.0f), series);  // no denormals
}

/// Sums of two series: at most kRun batches are added in T before they go to double.
template <class T>
class PairSum {
 public:
  void add(const Batch<T>& a, const Batch<T>& b) {
    a_ += a;
    b_ += b;
    if (++batches_ == kRun) flush();
  }
  void result(double* sums) {
    flush();
    sums[0] = total_a_;
    sums[1] = total_b_;
  }

 private:
  static constexpr int kRun = 32;
  void flush() {
    alignas(Batch<T>) T lanes[kLanes<T>];
    a_.store_aligned(lanes);
    for (const T v : lanes) total_a_ += v;
    b_.store_aligned(lanes);
    for (const T v : lanes) total_b_ += v;
    a_ = b_ = Batch<T>(T(0));
    batches_ = 0;
  }
  Batch<T> a_ = Batch<T>(T(0)), b_ = Batch<T>(T(0));
  double total_a_ = 0, total_b_ = 0;
  int batches_ = 0;
};

}  // namespace satsurf::SATSURF_KERNEL_ISA

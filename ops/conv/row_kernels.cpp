// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/conv/row_kernels.h"

#include "satsurf/ops/batch_kernels.h"
#include "satsurf/ops/conv/winograd.h"

#include <cstddef>

namespace satsurf::SATSURF_KERNEL_ISA {
namespace {

using conv::winograd::kMixes, conv::winograd::kOutputs;

/// Vectors from the front and one more that ends with the row; shorter rows by shorter vectors.
template <class T, std::size_t Bytes = kBatchBytes<T>>
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

template <class T, std::size_t Bytes>
void split_vector(const T* src, T* even, T* odd) {
  using P = Part<T, Bytes>;
  const auto a = P::load(src), b = P::load(src + P::kCount);
  P::store(even, P::even(a, b));
  P::store(odd, P::odd(a, b));
}

/// even[i] = src[2 i], odd[i] = src[2 i + 1], walking as copy_row does.
template <class T, std::size_t Bytes = kBatchBytes<T>>
void split_row(const T* src, T* even, T* odd, Index n) {
  using P = Part<T, Bytes>;
  if (n < P::kCount) {
    if constexpr (Bytes > 16) return split_row<T, Bytes / 2>(src, even, odd, n);
    for (Index i = 0; i < n; ++i) {
      even[i] = src[2 * i];
      odd[i] = src[2 * i + 1];
    }
    return;
  }
  for (Index i = 0; i + P::kCount <= n; i += P::kCount)
    split_vector<T, Bytes>(src + 2 * i, even + i, odd + i);
  const Index i = n - P::kCount;
  split_vector<T, Bytes>(src + 2 * i, even + i, odd + i);
}

/// pad_row with one phase: dst[i] = src[i - left] where there is such an element, else 0.
template <class T>
void shift_row(const T* src, Index n, Index left, T* dst, Index count) {
  for (Index i = 0; i < left; ++i) dst[i] = T(0);
  if (left < 0) {
    src -= left;
    n += left;
    left = 0;
  }
  const Index copied = n < count - left ? n : count - left;
  copy_row(src, dst + left, copied);
  for (Index i = left + copied; i < count; ++i) dst[i] = T(0);
}

template <class T>
void pad_row(const T* src, Index n, Index left, Index phases, T* dst, Index phase_stride,
             Index count) {
  if (phases == 1 && left < count && n + left > 0) return shift_row(src, n, left, dst, count);
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
    const Batch<T> left = Batch<T>::load_unaligned(even + i) + bias,
                   right = Batch<T>::load_unaligned(odd + i) + bias;
    Batch<T> a = interleave_low(left, right), b = interleave_high(left, right);
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

template <class T>
struct Points {
  static constexpr T a = T(conv::winograd::kA), b = T(conv::winograd::kB);
  static constexpr T a2 = T(conv::winograd::kA2), b2 = T(conv::winograd::kB2);
};

/// u = B x. The even and the odd powers are shared by the two signs of a point.
template <class T>
void mix_input(const Batch<T> (&x)[kMixes], Batch<T> (&u)[kMixes]) {
  using P = Points<T>;
  const Batch<T> a(P::a), b(P::b), a2(P::a2), b2(P::b2), ab(P::a2 * P::b2), sum(P::a2 + P::b2);
  u[0] = xsimd::fma(ab, x[0], xsimd::fnma(sum, x[2], x[4]));
  u[5] = xsimd::fma(ab, x[1], xsimd::fnma(sum, x[3], x[5]));
  const Batch<T> even_a = xsimd::fnma(b2, x[2], x[4]), odd_a = xsimd::fnma(b2, x[1], x[3]);
  u[1] = xsimd::fma(a, odd_a, even_a);
  u[2] = xsimd::fnma(a, odd_a, even_a);
  const Batch<T> even_b = xsimd::fnma(a2, x[2], x[4]), odd_b = xsimd::fnma(a2, x[1], x[3]);
  u[3] = xsimd::fma(b, odd_b, even_b);
  u[4] = xsimd::fnma(b, odd_b, even_b);
}

/// y = A m
template <class T>
void mix_output(const Batch<T> (&m)[kMixes], Batch<T> (&y)[kOutputs]) {
  using P = Points<T>;
  const Batch<T> a(P::a), b(P::b), a2(P::a2), b2(P::b2), a3(P::a * P::a2), b3(P::b * P::b2);
  const Batch<T> sum_a = m[1] + m[2], difference_a = m[1] - m[2];
  const Batch<T> sum_b = m[3] + m[4], difference_b = m[3] - m[4];
  y[0] = m[0] + (sum_a + sum_b);
  y[1] = xsimd::fma(a, difference_a, b * difference_b);
  y[2] = xsimd::fma(a2, sum_a, b2 * sum_b);
  y[3] = xsimd::fma(a3, difference_a, xsimd::fma(b3, difference_b, m[5]));
}

/// m = the adjoint of A applied to y
template <class T>
void mix_gradient(const Batch<T> (&y)[kOutputs], Batch<T> (&m)[kMixes]) {
  using P = Points<T>;
  const Batch<T> a(P::a), b(P::b), a2(P::a2), b2(P::b2);
  m[0] = y[0];
  m[5] = y[3];
  const Batch<T> even_a = xsimd::fma(a2, y[2], y[0]), odd_a = xsimd::fma(a2, y[3], y[1]);
  m[1] = xsimd::fma(a, odd_a, even_a);
  m[2] = xsimd::fnma(a, odd_a, even_a);
  const Batch<T> even_b = xsimd::fma(b2, y[2], y[0]), odd_b = xsimd::fma(b2, y[3], y[1]);
  m[3] = xsimd::fma(b, odd_b, even_b);
  m[4] = xsimd::fnma(b, odd_b, even_b);
}

/// Mixes N rows vector by vector. A row's last vector ends with the row; rows shorter than one go
/// through a buffer.
template <class T, Index N, class Mix>
void mix_rows(const T* const* src, Index n, T* dst, Index mix_stride, const Mix& mix) {
  constexpr Index L = kLanes<T>;
  const T* rows[N];
#pragma GCC unroll 8
  for (Index k = 0; k < N; ++k) rows[k] = src[k];
  Batch<T> in[N], out[kMixes];
  if (n < L) {
#pragma GCC unroll 8
    for (Index k = 0; k < N; ++k) in[k] = load(rows[k], n);
    mix(in, out);
#pragma GCC unroll 8
    for (Index i = 0; i < kMixes; ++i) store(dst + i * mix_stride, out[i], n);
    return;
  }
  for (Index p = 0; p < n; p += L) {
    const Index at = p + L <= n ? p : n - L;
#pragma GCC unroll 8
    for (Index k = 0; k < N; ++k) in[k] = Batch<T>::load_unaligned(rows[k] + at);
    mix(in, out);
#pragma GCC unroll 8
    for (Index i = 0; i < kMixes; ++i) out[i].store_unaligned(dst + i * mix_stride + at);
  }
}

template <class T>
void fill_zero(T* dst, Index n) {
  for (Index i = 0; i < n; ++i) dst[i] = T(0);
}

template <class T>
void mix_input_rows(const T* const* src, Index n, Index left, T* dst, Index mix_stride,
                    Index count) {
  // vectors first: what they write beyond the row is made zero after
  mix_rows<T, kMixes>(src, n, dst + left, mix_stride,
                      [](const auto& x, auto& u) { mix_input(x, u); });
  for (Index i = 0; i < kMixes; ++i) {
    fill_zero(dst + i * mix_stride, left);
    fill_zero(dst + i * mix_stride + left + n, count - left - n);
  }
}

template <class T>
void mix_gradient_rows(const T* const* src, Index n, T* dst, Index mix_stride, Index count) {
  mix_rows<T, kOutputs>(src, n, dst, mix_stride,
                        [](const auto& y, auto& m) { mix_gradient(y, m); });
  for (Index i = 0; i < kMixes; ++i) fill_zero(dst + i * mix_stride + n, count - n);
}

/// Adds the bias, and what is there if asked, to one vector of an output row and stores it.
template <class T>
void put(const Batch<T>& v, T bias, bool accumulate, T* to, Index count) {
  Batch<T> sum = v + bias;
  if (accumulate) sum += load(to, count);
  store(to, sum, count);
}

template <class T>
void mix_output_rows(const T* src, Index mix_stride, T bias, bool accumulate, T* dst,
                     Index dst_stride, Index rows, Index n) {
  constexpr Index L = kLanes<T>;
  Batch<T> m[kMixes], y[kOutputs];
  Index p = 0;
  if (rows == kOutputs && !accumulate) {  // nearly always
    for (; p + L <= n; p += L) {
#pragma GCC unroll 8
      for (Index i = 0; i < kMixes; ++i) m[i] = Batch<T>::load_unaligned(src + i * mix_stride + p);
      mix_output(m, y);
#pragma GCC unroll 8
      for (Index j = 0; j < kOutputs; ++j) (y[j] + bias).store_unaligned(dst + j * dst_stride + p);
    }
  }
  for (; p < n; p += L) {
    const Index count = n - p < L ? n - p : L;
#pragma GCC unroll 8
    for (Index i = 0; i < kMixes; ++i) m[i] = load(src + i * mix_stride + p, count);
    mix_output(m, y);
#pragma GCC unroll 8
    for (Index j = 0; j < kOutputs; ++j)
      if (j < rows) put(y[j], bias, accumulate, dst + j * dst_stride + p, count);
  }
}

}  // namespace

}  // namespace satsurf::SATSURF_KERNEL_ISA

namespace satsurf {

template <class T>
template <Isa isa>
ConvRowKernels<T> ConvRowKernels<T>::compiled_for() {
  const auto pointwise = PointwiseKernels<T>::template compiled_for<isa>();
  return {.pad = here::pad_row<T>,
          .store = here::store_row<T>,
          .normalise = pointwise.norm_apply,
          .sums = pointwise.norm_sums,
          .mix_input = here::mix_input_rows<T>,
          .mix_output = here::mix_output_rows<T>,
          .mix_gradient = here::mix_gradient_rows<T>};
}
template ConvRowKernels<float> ConvRowKernels<float>::compiled_for<kIsa>();
template ConvRowKernels<double> ConvRowKernels<double>::compiled_for<kIsa>();

}  // namespace satsurf

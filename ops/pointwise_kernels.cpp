// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/pointwise_kernels.h"

#include "satsurf/ops/batch_kernels.h"
#include "satsurf/ops/normalised.h"

namespace satsurf::SATSURF_KERNEL_ISA {
namespace {

inline Batch<double> gelu_of(const Batch<double>& x) {
  return x * (0.5 * (1.0 + xsimd::erf(x * 0.70710678118654752440)));
}
inline Batch<double> gelu_slope(const Batch<double>& x) {
  const Batch<double> cdf = 0.5 * (1.0 + xsimd::erf(x * 0.70710678118654752440));
  return xsimd::fma(x, 0.39894228040143267794 * xsimd::exp(-0.5 * x * x), cdf);
}

// In single precision from polynomials alone: divisions and exponentials would take longer than
// memory does. Minimax fits for 0 <= a < kNoTail, beyond which a Phi(-a) < 2e-8.
constexpr float kNoTail = 5.8f;
template <std::size_t N>
Batch<float> polynomial(const float (&coefficients)[N], const Batch<float>& a) {  // highest first
  Batch<float> sum(coefficients[0]);
#pragma GCC unroll 16
  for (std::size_t i = 1; i < N; ++i) sum = xsimd::fma(sum, a, Batch<float>(coefficients[i]));
  return sum;
}
/// Phi(-a); its eighth root is a smooth line, error 4e-9.
inline Batch<float> normal_tail(const Batch<float>& a) {
  constexpr float kRoot[] = {-2.92480795e-07f, 7.42745678e-06f, -5.99325338e-05f,
                             3.32262268e-05f,  0.00150636035f,  -0.000674090762f,
                             -0.0319268376f,   -0.0914577564f,  0.91700404f};
  Batch<float> power = polynomial(kRoot, a);
  power *= power;
  power *= power;
  return power * power;
}
/// x Phi(x) = max(x, 0) - a Phi(-a), a = |x|
inline Batch<float> gelu_of(const Batch<float>& x) {
  const Batch<float> a = xsimd::abs(x), zero(0.0f);
  const Batch<float> rest = xsimd::select(a < kNoTail, a * normal_tail(a), zero);
  return xsimd::max(zero, x) - rest;  // the second operand stays if it is NaN
}
/// Phi(x) + x phi(x), which at -a is Phi(-a) (1 - a phi(a) / Phi(-a)), and 1 less that at a
inline Batch<float> gelu_slope(const Batch<float>& x) {
  constexpr float kRatio[] = {1.1631409e-05f, -0.000148207268f, 0.000599204439f, 0.000830186548f,
                              -0.0199628154f, 0.109367373f,     0.63654865f,     0.797888954f};
  const Batch<float> a = xsimd::abs(x), one(1.0f);
  const Batch<float> below = normal_tail(a) * xsimd::fnma(a, polynomial(kRatio, a), one);
  const Batch<float> left = xsimd::select(a >= kNoTail, Batch<float>(0.0f), below);  // NaN stays
  return xsimd::select(x < 0.0f, left, one - left);
}

template <class T>
Batch<T> logistic_of(const Batch<T>& x) {
  const Batch<T> e = exp_below(-xsimd::abs(x));  // never overflows
  return xsimd::select(x < T(0), e, Batch<T>(1)) / (T(1) + e);
}

struct NoActivation {
  template <class B>
  B value(const B& z) const {
    return z;
  }
  template <class B>
  B times_slope(const B& g, const B&) const {
    return g;
  }
};
struct Relu {
  template <class B>
  B value(const B& z) const {
    return xsimd::select(z < B(0), B(0), z);  // NaN stays
  }
  template <class B>
  B times_slope(const B& g, const B& z) const {
    return xsimd::select(z > B(0), g, B(0));
  }
};
struct Gelu {
  template <class B>
  B value(const B& z) const {
    return gelu_of(z);
  }
  template <class B>
  B times_slope(const B& g, const B& z) const {
    return g * gelu_slope(z);
  }
};

/// d = value(at, lanes) for whole batches and the tail, or d += that.
template <class T, class Value>
void each_gradient(Index n, bool accumulate, T* d, const Value& value) {
  if (accumulate)
    each_batch<T>(n, [&](Index i, Index k) { store(d + i, load(d + i, k) + value(i, k), k); });
  else
    each_batch<T>(n, [&](Index i, Index k) { store(d + i, value(i, k), k); });
}

template <class Body>
void with_activation(Activation activation, const Body& body) {
  if (activation == Activation::relu)
    body(Relu{});
  else if (activation == Activation::gelu)
    body(Gelu{});
  else
    body(NoActivation{});
}

template <class T>
void relu_backward(Index n, const T* y, const T* g, bool accumulate, T* d) {
  each_gradient(n, accumulate, d, [=](Index i, Index k) {
    return Relu{}.times_slope(load(g + i, k), load(y + i, k));
  });
}

template <class T>
void gelu(Index n, const T* x, T* y) {
  each_batch<T>(n, [=](Index i, Index k) { store(y + i, gelu_of(load(x + i, k)), k); });
}

template <class T>
void gelu_backward(Index n, const T* x, const T* g, bool accumulate, T* d) {
  each_gradient(n, accumulate, d,
                [=](Index i, Index k) { return load(g + i, k) * gelu_slope(load(x + i, k)); });
}

template <class T>
void logistic(Index n, const T* x, T* y) {
  each_batch<T>(n, [=](Index i, Index k) { store(y + i, logistic_of(load(x + i, k)), k); });
}

template <class T>
void norm_sums(Index n, const T* x, T shift, double* sums) {
  PairSum<T> total;
  const Index whole = n / kLanes<T> * kLanes<T>;
  each_batch<T>(whole, [&](Index i, Index k) {
    const Batch<T> e = load(x + i, k) - shift;
    total.add(e, e * e);
  });
  total.result(sums);
  for (Index i = whole; i < n; ++i) {
    const double e = x[i] - shift;
    sums[0] += e;
    sums[1] += e * e;
  }
}

template <class T>
void norm_apply(Index n, const T* x, const NormRow<T>& row, Activation activation, const T* base,
                T* y) {
  const Batch<T> centre(row.centre), scale(row.scale), shift(row.shift);
  with_activation(activation, [&](const auto& act) {
    const auto value = [&](Index i, Index k) {
      return act.value(xsimd::fma(scale, load(x + i, k) - centre, shift));
    };
    if (base == nullptr)
      each_batch<T>(n, [&](Index i, Index k) { store(y + i, value(i, k), k); });
    else
      each_batch<T>(n, [&](Index i, Index k) { store(y + i, load(base + i, k) + value(i, k), k); });
  });
}

template <class T>
void norm_backward(Index n, const T* x, const T* g, const NormRow<T>& row, Activation activation,
                   bool accumulate, T* d, double* sums) {
  const Batch<T> centre(row.centre), scale(row.scale), shift(row.shift);
  PairSum<T> total;
  with_activation(activation, [&](const auto& act) {
    const auto slope = [&](Index i, Index k) {
      const Batch<T> centred = load(x + i, k) - centre;
      // 0 beyond k, where g is 0
      const Batch<T> dz = act.times_slope(load(g + i, k), xsimd::fma(scale, centred, shift));
      total.add(dz, dz * centred);
      return dz;
    };
    if (d == nullptr)
      each_batch<T>(n, [&](Index i, Index k) { slope(i, k); });
    else if (accumulate)
      each_batch<T>(n, [&](Index i, Index k) {
        store(d + i, xsimd::fma(scale, slope(i, k), load(d + i, k)), k);
      });
    else
      each_batch<T>(n, [&](Index i, Index k) { store(d + i, scale * slope(i, k), k); });
  });
  total.result(sums);
}

template <class T>
void norm_add_linear(Index n, const T* x, const NormRow<T>& row, T* d) {
  const Batch<T> centre(row.centre), scale(row.scale), shift(row.shift);
  each_batch<T>(n, [&](Index i, Index k) {
    store(d + i, load(d + i, k) + xsimd::fma(scale, load(x + i, k) - centre, shift), k);
  });
}

}  // namespace
}  // namespace satsurf::SATSURF_KERNEL_ISA

namespace satsurf {

template <class T>
template <Isa isa>
PointwiseKernels<T> PointwiseKernels<T>::compiled_for() {
  return {.relu_backward = here::relu_backward<T>,
          .gelu = here::gelu<T>,
          .gelu_backward = here::gelu_backward<T>,
          .logistic = here::logistic<T>,
          .norm_sums = here::norm_sums<T>,
          .norm_apply = here::norm_apply<T>,
          .norm_backward = here::norm_backward<T>,
          .norm_add_linear = here::norm_add_linear<T>};
}
template PointwiseKernels<float> PointwiseKernels<float>::compiled_for<kIsa>();
template PointwiseKernels<double> PointwiseKernels<double>::compiled_for<kIsa>();

}  // namespace satsurf

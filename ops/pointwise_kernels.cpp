// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/pointwise_kernels.h"

#include "satsurf/ops/batch_kernels.h"
#include "satsurf/ops/normalised.h"

namespace satsurf::SATSURF_ISA_NS {
namespace {

/// Standard normal distribution function and density.
inline void normal_distribution(const Batch<double>& x, Batch<double>& cdf,
                                Batch<double>& density) {
  cdf = 0.5 * (1.0 + xsimd::erf(x * 0.70710678118654752440));
  density = 0.39894228040143267794 * xsimd::exp(-0.5 * x * x);
}
inline void normal_distribution(const Batch<float>& x, Batch<float>& cdf, Batch<float>& density) {
  // erfc(z) exp(z^2) for z = |x| / sqrt 2 as a polynomial in t = 1 / (1 + 0.4 z): Chebyshev fit on
  // z <= 9.4, error 8e-9. One exponential serves both results.
  const Batch<float> t = 1.0f / (1.0f + 0.28284271f * xsimd::abs(x));
  const float c[] = {-0.00556853959f, -0.222986896f, 0.483438187f, -0.237060009f,  0.356712266f,
                     0.147815247f,    0.237513726f,  0.224363594f, 6.22769063e-05f};
  Batch<float> series(0.0157101552f);
  for (const float k : c) series = xsimd::fma(series, t, Batch<float>(k));
  const Batch<float> bell = exp_below(-0.5f * x * x);
  const Batch<float> tail = 0.5f * series * bell;
  cdf = xsimd::select(x < 0.0f, tail, 1.0f - tail);
  density = 0.39894228f * bell;
}

template <class T>
Batch<T> gelu_of(const Batch<T>& x) {
  Batch<T> cdf, density;
  normal_distribution(x, cdf, density);
  return x * cdf;
}
template <class T>
Batch<T> gelu_slope(const Batch<T>& x) {
  Batch<T> cdf, density;
  normal_distribution(x, cdf, density);
  return xsimd::fma(x, density, cdf);
}

template <class T>
Batch<T> logistic_of(const Batch<T>& x) {
  const Batch<T> e = exp_below(-xsimd::abs(x));  // never overflows
  return xsimd::select(x < T(0), e, Batch<T>(1)) / (T(1) + e);
}

/// log(1 + e) for 0 <= e <= 1.
inline Batch<double> log1p_of(const Batch<double>& e) { return xsimd::log1p(e); }
inline Batch<float> log1p_of(const Batch<float>& e) {
  // 2 artanh(s) for s = e / (2 + e) <= 1/3: Taylor in s^2 up to s^15, beyond which there is 3e-9 s
  const Batch<float> s = e / (2.0f + e), squared = s * s;
  const float c[] = {2 / 13.0f, 2 / 11.0f, 2 / 9.0f, 2 / 7.0f, 2 / 5.0f, 2 / 3.0f};
  Batch<float> series(2 / 15.0f);
  for (const float k : c) series = xsimd::fma(series, squared, Batch<float>(k));
  return xsimd::fma(s * squared, series, s + s);
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

template <class Body>
void with_activation(Activation activation, const Body& body) {
  if (activation == Activation::relu)
    body(Relu{});
  else if (activation == Activation::gelu)
    body(Gelu{});
  else
    body(NoActivation{});
}

}  // namespace

template <class T>
void relu_backward(Index n, const T* y, const T* g, T* d) {
  each_batch<T>(n, [=](Index i, Index k) {
    store(d + i, load(d + i, k) + Relu{}.times_slope(load(g + i, k), load(y + i, k)), k);
  });
}

template <class T>
void gelu(Index n, const T* x, T* y) {
  each_batch<T>(n, [=](Index i, Index k) { store(y + i, gelu_of(load(x + i, k)), k); });
}

template <class T>
void gelu_backward(Index n, const T* x, const T* g, T* d) {
  each_batch<T>(n, [=](Index i, Index k) {
    store(d + i, xsimd::fma(load(g + i, k), gelu_slope(load(x + i, k)), load(d + i, k)), k);
  });
}

template <class T>
void logistic(Index n, const T* x, T* y) {
  each_batch<T>(n, [=](Index i, Index k) { store(y + i, logistic_of(load(x + i, k)), k); });
}

template <class T>
void softplus(Index n, const T* x, T* y) {
  each_batch<T>(n, [=](Index i, Index k) {
    const Batch<T> v = load(x + i, k);
    const Batch<T> more = log1p_of(exp_below(-xsimd::abs(v)));  // never overflows
    store(y + i, xsimd::max(v, Batch<T>(T(0))) + more, k);
  });
}

template <class T>
void softplus_backward(Index n, const T* x, const T* g, T* d) {
  each_batch<T>(n, [=](Index i, Index k) {
    const Batch<T> slope = logistic_of(load(x + i, k));
    store(d + i, xsimd::fma(load(g + i, k), slope, load(d + i, k)), k);
  });
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
    const double e = static_cast<double>(x[i] - shift);
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
                   T* d, double* sums) {
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
    else
      each_batch<T>(n, [&](Index i, Index k) {
        store(d + i, xsimd::fma(scale, slope(i, k), load(d + i, k)), k);
      });
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

template void relu_backward(Index, const float*, const float*, float*);
template void relu_backward(Index, const double*, const double*, double*);
template void gelu(Index, const float*, float*);
template void gelu(Index, const double*, double*);
template void gelu_backward(Index, const float*, const float*, float*);
template void gelu_backward(Index, const double*, const double*, double*);
template void logistic(Index, const float*, float*);
template void logistic(Index, const double*, double*);
template void softplus(Index, const float*, float*);
template void softplus(Index, const double*, double*);
template void softplus_backward(Index, const float*, const float*, float*);
template void softplus_backward(Index, const double*, const double*, double*);
template void norm_sums(Index, const float*, float, double*);
template void norm_sums(Index, const double*, double, double*);
template void norm_apply(Index, const float*, const NormRow<float>&, Activation, const float*,
                         float*);
template void norm_apply(Index, const double*, const NormRow<double>&, Activation, const double*,
                         double*);
template void norm_backward(Index, const float*, const float*, const NormRow<float>&, Activation,
                            float*, double*);
template void norm_backward(Index, const double*, const double*, const NormRow<double>&, Activation,
                            double*, double*);
template void norm_add_linear(Index, const float*, const NormRow<float>&, float*);
template void norm_add_linear(Index, const double*, const NormRow<double>&, double*);

}  // namespace satsurf::SATSURF_ISA_NS

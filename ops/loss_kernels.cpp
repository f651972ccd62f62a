// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/loss_kernels.h"

#include "satsurf/ops/batch_kernels.h"

namespace satsurf::SATSURF_KERNEL_ISA {
namespace {

template <class T>
struct Squared {
  Batch<T> value(const Batch<T>& e) const { return e * e; }
  Batch<T> slope(const Batch<T>& e) const { return e + e; }
};

template <class T>
struct SmoothL1 {
  Batch<T> beta, half, inverse;
  explicit SmoothL1(T b) : beta(b), half(T(0.5) * b), inverse(T(1) / b) {}
  Batch<T> value(const Batch<T>& e) const {
    const Batch<T> size = xsimd::abs(e), share = size * inverse;
    return xsimd::select(size < beta, half * share * share, size - half);
  }
  Batch<T> slope(const Batch<T>& e) const {
    return xsimd::max(Batch<T>(T(-1)), xsimd::min(Batch<T>(T(1)), e * inverse));
  }
};

template <class T, class Body>
void with_distance(Distance distance, T beta, const Body& body) {
  if (distance == Distance::squared)
    body(Squared<T>{});
  else
    body(SmoothL1<T>(beta));
}

/// The weights and errors of one batch; 0 beyond `lanes`.
template <class T>
struct Errors {
  Batch<T> weight, error;
  Errors(const T* x, const T* target, const T* w, Index lanes) : weight(T(1)) {
    error = load(x, lanes) - load(target, lanes);
    if (w == nullptr) return;
    weight = load(w, lanes);
    error = xsimd::select(weight == T(0), Batch<T>(T(0)), error);
  }
};

template <class T>
void sums(Distance distance, T beta, Index n, const T* x, const T* target, const T* weight,
          double* result) {
  with_distance<T>(distance, beta, [&](const auto& l) {
    PairSum<T> total;
    each_batch<T>(n, [&](Index i, Index k) {
      const Errors<T> at(x + i, target + i, weight == nullptr ? nullptr : weight + i, k);
      total.add(at.weight * l.value(at.error), at.weight);
    });
    total.result(result);
  });
  if (weight == nullptr) result[1] = static_cast<double>(n);
}

template <class T>
void backward(Distance distance, T beta, T factor, Index n, const T* x, const T* target,
              const T* weight, T* d) {
  with_distance<T>(distance, beta, [&](const auto& l) {
    each_batch<T>(n, [&](Index i, Index k) {
      const Errors<T> at(x + i, target + i, weight == nullptr ? nullptr : weight + i, k);
      store(d + i, xsimd::fma(factor * at.weight, l.slope(at.error), load(d + i, k)), k);
    });
  });
}

}  // namespace

}  // namespace satsurf::SATSURF_KERNEL_ISA

namespace satsurf {

template <class T>
template <Isa isa>
LossKernels<T> LossKernels<T>::compiled_for() {
  return {.sums = here::sums<T>, .backward = here::backward<T>};
}
template LossKernels<float> LossKernels<float>::compiled_for<kIsa>();
template LossKernels<double> LossKernels<double>::compiled_for<kIsa>();

}  // namespace satsurf

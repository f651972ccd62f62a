// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/reduce.h"

#include "satsurf/core/parallel.h"

#include <algorithm>
#include <array>
#include <string>

namespace satsurf {
namespace {

constexpr Index kGrain = 1 << 14;

/// Sum of term(i) over [0, n).
template <class Term>
double ordered_sum(Index n, const Term& term) {
  return ordered_reduce(n, kGrain, 0.0, [&](Index begin, Index end) {
    constexpr Index kSums = 8;  // independent chains: one alone waits for every addition
    std::array<double, kSums> s{};
    Index i = begin;
    for (; i + kSums <= end; i += kSums)
      for (Index k = 0; k < kSums; ++k) s[k] += term(i + k);
    for (; i < end; ++i) s[0] += term(i);
    return ((s[0] + s[4]) + (s[1] + s[5])) + ((s[2] + s[6]) + (s[3] + s[7]));
  });
}

/// `factor` times the sum.
template <class T>
BasicVar<T> scaled_sum(const char* op, const BasicVar<T>& x, double factor) {
  const T* from = x.value().data();
  const T total =
      static_cast<T>(factor * ordered_sum(x.count(), [from](Index i) { return from[i]; }));
  return BasicVar<T>::record(op, BasicTensor<T>::scalar(total), {x}, [factor](Node<T>& n) {
    const T g = static_cast<T>(n.grad[0] * factor);
    if (T* dx = n.grad_in(0))
      for_range(n.inputs[0]->value.count(), kGrain, [=](Index begin, Index end) {
        for (Index i = begin; i < end; ++i) dx[i] += g;
      });
  });
}

template <class T>
void check_shape(const char* name, const BasicTensor<T>& t, const Shape& x) {
  if (t.shape() != x)
    throw ShapeError(std::string("masked_mean: ") + name + " has shape " + t.shape().str() +
                     ", expected " + x.str() + " from x");
}

}  // namespace

template <class T>
BasicVar<T> sum(const BasicVar<T>& x) {
  return scaled_sum("sum", x, 1.0);
}

template <class T>
BasicVar<T> mean(const BasicVar<T>& x) {
  if (x.count() == 0)
    throw ShapeError("mean: x has shape " + x.shape().str() + ", expected at least one element");
  return scaled_sum("mean", x, 1.0 / static_cast<double>(x.count()));
}

template <class T>
BasicVar<T> masked_mean(const BasicVar<T>& x, const BasicTensor<T>& mask,
                        const BasicTensor<T>& valid) {
  check_shape("mask", mask, x.shape());
  if (!valid.empty()) check_shape("valid", valid, x.shape());
  const T *from = x.value().data(), *m = mask.data(), *counts = valid.data();
  const auto n = static_cast<double>(x.count());
  const double total =
      ordered_sum(x.count(), [=](Index i) { return m[i] != T(0) ? m[i] * from[i] : T(0); });
  const double number = valid.empty() ? n : ordered_sum(x.count(), [=](Index i) {
    return counts[i] != T(0) ? 1.0 : 0.0;
  });
  const double factor = 1.0 / std::max(number, 1.0);
  const auto out = BasicTensor<T>::scalar(static_cast<T>(factor * total));
  return BasicVar<T>::record("masked_mean", out, {x}, [mask, factor](Node<T>& node) {
    const T g = static_cast<T>(node.grad[0] * factor);
    if (T* dx = node.grad_in(0))
      for_range(mask.count(), kGrain, [=, &mask](Index begin, Index end) {
        for (Index i = begin; i < end; ++i) dx[i] += g * mask[i];
      });
  });
}

template BasicVar<float> sum(const BasicVar<float>&);
template BasicVar<double> sum(const BasicVar<double>&);
template BasicVar<float> mean(const BasicVar<float>&);
template BasicVar<double> mean(const BasicVar<double>&);
template BasicVar<float> masked_mean(const BasicVar<float>&, const BasicTensor<float>&,
                                     const BasicTensor<float>&);
template BasicVar<double> masked_mean(const BasicVar<double>&, const BasicTensor<double>&,
                                      const BasicTensor<double>&);

}  // namespace satsurf

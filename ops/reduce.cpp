// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/reduce.h"

#include "satsurf/core/parallel.h"

#include <array>

namespace satsurf {
namespace {

constexpr Index kGrain = 1 << 14;

template <class T>
double ordered_sum(const BasicTensor<T>& x) {
  return ordered_reduce(x.count(), kGrain, 0.0, [&](Index begin, Index end) {
    constexpr Index kSums = 8;  // independent chains: one alone waits for every addition
    std::array<double, kSums> s{};
    Index i = begin;
    for (; i + kSums <= end; i += kSums)
      for (Index k = 0; k < kSums; ++k)
        s[static_cast<std::size_t>(k)] += static_cast<double>(x[i + k]);
    for (; i < end; ++i) s[0] += static_cast<double>(x[i]);
    return ((s[0] + s[4]) + (s[1] + s[5])) + ((s[2] + s[6]) + (s[3] + s[7]));
  });
}

/// `factor` times the sum.
template <class T>
BasicVar<T> scaled_sum(const char* op, const BasicVar<T>& x, double factor) {
  const T total = static_cast<T>(factor * ordered_sum(x.value()));
  return BasicVar<T>::record(op, BasicTensor<T>::scalar(total), {x}, [factor](Node<T>& n) {
    const T g = static_cast<T>(static_cast<double>(n.grad[0]) * factor);
    if (T* dx = n.grad_in(0))
      for_range(n.inputs[0]->value.count(), kGrain, [=](Index begin, Index end) {
        for (Index i = begin; i < end; ++i) dx[i] += g;
      });
  });
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

template BasicVar<float> sum(const BasicVar<float>&);
template BasicVar<double> sum(const BasicVar<double>&);
template BasicVar<float> mean(const BasicVar<float>&);
template BasicVar<double> mean(const BasicVar<double>&);

}  // namespace satsurf

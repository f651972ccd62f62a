// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/loss.h"

#include "satsurf/core/isa.h"
#include "satsurf/core/parallel.h"
#include "satsurf/ops/loss_kernels.h"
#include "satsurf/ops/weighted_sum.h"

#include <algorithm>
#include <string>

namespace satsurf {
namespace {

constexpr Index kGrain = 1 << 14;
template <class T>
void check(const char* op, const char* name, const BasicTensor<T>& t, const Shape& x) {
  if (t.shape() != x)
    throw ShapeError(std::string(op) + ": " + name + " has shape " + t.shape().str() +
                     ", expected " + x.str() + " from x");
}

/// sum(w l(x - target)) / max(sum(w), least).
template <class T>
BasicVar<T> weighted_mean(const char* op, const BasicVar<T>& x, const BasicTensor<T>& target,
                          const BasicTensor<T>& weight, Distance distance, T beta) {
  check(op, "target", target, x.shape());
  if (!weight.empty()) check(op, "weight", weight, x.shape());
  const auto from = [](const BasicTensor<T>& t, Index i) {
    return t.empty() ? nullptr : t.data() + i;
  };
  const auto& kernels = active_kernels<LossKernels<T>>();
  const WeightedSum sums =
      ordered_reduce(x.count(), kGrain, WeightedSum{}, [&](Index begin, Index end) {
        double of_piece[2];
        kernels.sums(distance, beta, end - begin, x.value().data() + begin, target.data() + begin,
                     from(weight, begin), of_piece);
        return WeightedSum{of_piece[0], of_piece[1]};
      });
  const double total = sums.total();
  const auto out = BasicTensor<T>::scalar(static_cast<T>(sums.mean()));
  return BasicVar<T>::record(op, out, {x}, [=](Node<T>& n) {
    T* dx = n.grad_in(0);
    if (dx == nullptr) return;
    const T factor = static_cast<T>(n.grad[0] / total);
    for_range(target.count(), kGrain, [=, &n](Index begin, Index end) {
      kernels.backward(distance, beta, factor, end - begin, n.in(0) + begin, target.data() + begin,
                       from(weight, begin), dx + begin);
    });
  });
}

}  // namespace

template <class T>
BasicVar<T> smooth_l1(const BasicVar<T>& x, const BasicTensor<T>& target,
                      const BasicTensor<T>& weight, T beta) {
  if (!(beta > 0))
    throw ConfigError("smooth_l1: beta is " + std::to_string(beta) +
                      ", expected a positive number");
  return weighted_mean("smooth_l1", x, target, weight, Distance::smooth_l1, beta);
}

template <class T>
BasicVar<T> mse(const BasicVar<T>& x, const BasicTensor<T>& target, const BasicTensor<T>& weight) {
  return weighted_mean("mse", x, target, weight, Distance::squared, T(1));
}

template BasicVar<float> smooth_l1(const BasicVar<float>&, const BasicTensor<float>&,
                                   const BasicTensor<float>&, float);
template BasicVar<double> smooth_l1(const BasicVar<double>&, const BasicTensor<double>&,
                                    const BasicTensor<double>&, double);
template BasicVar<float> mse(const BasicVar<float>&, const BasicTensor<float>&,
                             const BasicTensor<float>&);
template BasicVar<double> mse(const BasicVar<double>&, const BasicTensor<double>&,
                              const BasicTensor<double>&);

}  // namespace satsurf

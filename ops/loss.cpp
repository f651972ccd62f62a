// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/loss.h"

#include "satsurf/core/parallel.h"

#include <algorithm>
#include <cmath>
#include <string>

namespace satsurf {
namespace {

constexpr Index kGrain = 1 << 14;
constexpr double kLeastWeight = 1e-12;  // no weight at all: the loss is 0, not 0 / 0

struct Sums {
  double loss = 0, weight = 0;
  Sums& operator+=(const Sums& o) {
    loss += o.loss;
    weight += o.weight;
    return *this;
  }
};

template <class T>
void check(const char* op, const char* name, const BasicTensor<T>& t, const Shape& x) {
  if (t.shape() != x)
    throw ShapeError(std::string(op) + ": " + name + " has shape " + t.shape().str() +
                     ", expected " + x.str() + " from x");
}

/// sum(w l(x - target)) / max(sum(w), least); `slope` is the derivative of `l`. Elements of weight
/// 0 are never looked at.
template <class T, class Loss, class Slope>
BasicVar<T> weighted_mean(const char* op, const BasicVar<T>& x, const BasicTensor<T>& target,
                          const BasicTensor<T>& weight, Loss l, Slope slope) {
  check(op, "target", target, x.shape());
  if (!weight.empty()) check(op, "weight", weight, x.shape());
  const T *px = x.value().data(), *t = target.data(), *w = weight.data();
  const Sums sums = ordered_reduce(x.count(), kGrain, Sums{}, [=](Index begin, Index end) {
    Sums s;
    for (Index i = begin; i < end; ++i) {
      const double wi = w == nullptr ? 1.0 : static_cast<double>(w[i]);
      if (wi == 0) continue;
      s.loss += wi * l(static_cast<double>(px[i]) - static_cast<double>(t[i]));
      s.weight += wi;
    }
    return s;
  });
  const double total = std::max(sums.weight, kLeastWeight);
  const auto out = BasicTensor<T>::scalar(static_cast<T>(sums.loss / total));
  return BasicVar<T>::record(op, out, {x}, [=](Node<T>& n) {
    T* dx = n.grad_in(0);
    if (dx == nullptr) return;
    const T *v = n.in(0), *to = target.data(), *wt = weight.data();
    const double g = static_cast<double>(n.grad[0]) / total;
    for_range(target.count(), kGrain, [=](Index begin, Index end) {
      for (Index i = begin; i < end; ++i) {
        const double wi = wt == nullptr ? 1.0 : static_cast<double>(wt[i]);
        if (wi == 0) continue;
        dx[i] +=
            static_cast<T>(g * wi * slope(static_cast<double>(v[i]) - static_cast<double>(to[i])));
      }
    });
  });
}

}  // namespace

template <class T>
BasicVar<T> smooth_l1(const BasicVar<T>& x, const BasicTensor<T>& target,
                      const BasicTensor<T>& weight, T beta) {
  const double b = static_cast<double>(beta);
  if (!(b > 0))
    throw ConfigError("smooth_l1: beta is " + std::to_string(b) + ", expected a positive number");
  return weighted_mean(
      "smooth_l1", x, target, weight,
      [b](double e) { return std::abs(e) < b ? e * e / (2 * b) : std::abs(e) - b / 2; },
      [b](double e) { return std::clamp(e / b, -1.0, 1.0); });
}

template <class T>
BasicVar<T> mse(const BasicVar<T>& x, const BasicTensor<T>& target, const BasicTensor<T>& weight) {
  return weighted_mean(
      "mse", x, target, weight, [](double e) { return e * e; }, [](double e) { return 2 * e; });
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

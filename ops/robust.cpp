// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/robust.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

namespace satsurf {
namespace {

/// Reorders the values, of which there is at least one and none is NaN.
template <class T>
T median_in_place(std::vector<T>& values) {
  const auto middle = values.begin() + static_cast<Index>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  if (values.size() % 2 == 1) return *middle;
  const T below = *std::max_element(values.begin(), middle);
  return T(0.5) * below + T(0.5) * *middle;  // halved first: the sum may overflow
}

template <class T>
struct Normalised {
  BasicTensor<T> value;
  std::vector<T> slope;  ///< 1 / (MAD + eps) of each map
};

template <class T>
Normalised<T> normalise(const BasicTensor<T>& x, const BasicTensor<T>& valid, T eps) {
  Dims dim("robust_normalised");
  dim.match("x", x, "N H W");
  if (!valid.empty()) dim.match("valid", valid, "N H W");
  if (!(eps > 0))
    throw ConfigError("robust_normalised: eps is " + std::to_string(eps) +
                      ", expected a positive number");
  const Index N = dim["N"], P = dim["H"] * dim["W"];
  const auto map_of = [P](const BasicTensor<T>& t, Index n) {
    return t.empty() ? std::span<const T>() : std::span(t.data() + n * P, P);
  };
  Normalised<T> out{BasicTensor<T>::uninitialised(x.shape()), std::vector<T>(N)};
  for_each_index(N, [&](Index n) {
    const RobustScale<T> scale = robust_scale(map_of(x, n), map_of(valid, n));
    const T slope = T(1) / (scale.mad + eps);
    out.slope[n] = slope;
    const T* from = x.data() + n * P;
    const T* counts = valid.empty() ? nullptr : valid.data() + n * P;
    T* to = out.value.data() + n * P;
    for (Index i = 0; i < P; ++i) {
      const T y = (from[i] - scale.median) * slope;
      to[i] = counts == nullptr || counts[i] != T(0) ? y : T(0);
    }
  });
  return out;
}

}  // namespace

template <class T>
RobustScale<T> robust_scale(std::span<const T> values, std::span<const T> valid) {
  if (!valid.empty() && valid.size() != values.size())
    throw ShapeError("robust_scale: valid has " + std::to_string(valid.size()) +
                     " elements, expected " + std::to_string(values.size()) + " from values");
  std::vector<T> kept;
  kept.reserve(values.size());
  bool ordered = true;  // selection among NaNs is undefined
  for (std::size_t i = 0; i < values.size(); ++i) {
    if (!valid.empty() && valid[i] == T(0)) continue;
    kept.push_back(values[i]);
    ordered = ordered && !std::isnan(values[i]);
  }
  if (kept.empty()) return {};
  constexpr T kNan = std::numeric_limits<T>::quiet_NaN();
  if (!ordered) return {kNan, kNan};
  const T median = median_in_place(kept);
  if (!std::isfinite(median)) return {kNan, kNan};
  for (T& v : kept) v = std::abs(v - median);
  return {median, median_in_place(kept)};
}

template <class T>
BasicTensor<T> robust_normalised(const BasicTensor<T>& x, const BasicTensor<T>& valid, T eps) {
  return normalise(x, valid, eps).value;
}

template <class T>
BasicVar<T> robust_normalised(const BasicVar<T>& x, const BasicTensor<T>& valid, T eps) {
  Normalised<T> out = normalise(x.value(), valid, eps);
  const auto slope = std::move(out.slope);
  return BasicVar<T>::record("robust_normalised", out.value, {x}, [=](Node<T>& n) {
    T* dx = n.grad_in(0);
    if (dx == nullptr) return;
    const Index N = n.grad.dim(0), P = n.grad.shape().count(1, 3);
    for_each_index(N, [&, dx](Index m) {
      const T s = slope[m];
      for (Index i = m * P; i < (m + 1) * P; ++i)
        dx[i] += valid.empty() || valid[i] != T(0) ? n.grad[i] * s : T(0);
    });
  });
}

template struct RobustScale<float>;
template struct RobustScale<double>;
template RobustScale<float> robust_scale(std::span<const float>, std::span<const float>);
template RobustScale<double> robust_scale(std::span<const double>, std::span<const double>);
template BasicTensor<float> robust_normalised(const BasicTensor<float>&, const BasicTensor<float>&,
                                              float);
template BasicTensor<double> robust_normalised(const BasicTensor<double>&,
                                               const BasicTensor<double>&, double);
template BasicVar<float> robust_normalised(const BasicVar<float>&, const BasicTensor<float>&,
                                           float);
template BasicVar<double> robust_normalised(const BasicVar<double>&, const BasicTensor<double>&,
                                            double);

}  // namespace satsurf

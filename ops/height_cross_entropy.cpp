// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/height_cross_entropy.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"
#include "satsurf/ops/weighted_sum.h"

#include <algorithm>
#include <cmath>

namespace satsurf {
namespace {

constexpr double kLeastProbability = 1e-12;

/// The two hypotheses that a truth lies between, and the share of the upper one.
struct Bins {
  Index lower = -1, upper = -1;  ///< -1 where it is out of reach
  double share = 0;
};

template <class T>
Bins bins_of(const T* column, Index D, Index stride, double truth) {
  const double first = static_cast<double>(column[0]);
  if (D == 1) return {0, 0, 0};
  const double interval = static_cast<double>(column[stride]) - first,
               t = (truth - first) / interval;
  if (!(t >= -0.5 && t <= static_cast<double>(D) - 0.5)) return {};
  const double inside = std::clamp(t, 0.0, static_cast<double>(D - 1));
  const auto lower = std::min(static_cast<Index>(inside), D - 2);
  return {lower, lower + 1, inside - static_cast<double>(lower)};
}

}  // namespace

template <class T>
BasicVar<T> height_cross_entropy(const BasicVar<T>& probability, const BasicTensor<T>& heights,
                                 const BasicTensor<T>& truth, const BasicTensor<T>& weight) {
  Dims dim("height_cross_entropy");
  dim.match("probability", probability, "B D H W")
      .match("heights", heights, "B D H W")
      .match("truth", truth, "B H W")
      .match("weight", weight, "B H W");
  const Index D = dim["D"], P = dim["H"] * dim["W"], count = truth.count();
  if (D == 0)
    throw ShapeError("height_cross_entropy: probability has shape " + probability.shape().str() +
                     ", expected at least one hypothesis");
  constexpr Index kGrain = 1 << 12;
  // body(pixel of the volume's first hypothesis, its bins, its weight)
  const auto each = [=](Index begin, Index end, const auto& body) {
    for (Index i = begin; i < end; ++i) {
      if (!(weight[i] > 0)) continue;
      const Index at = i / P * D * P + i % P;
      const Bins bins = bins_of(heights.data() + at, D, P, static_cast<double>(truth[i]));
      if (bins.lower >= 0) body(at, bins, static_cast<double>(weight[i]));
    }
  };
  const T* p = probability.value().data();
  const WeightedSum sums =
      ordered_reduce(count, kGrain, WeightedSum{}, [&](Index begin, Index end) {
        WeightedSum piece;
        each(begin, end, [&](Index at, const Bins& b, double w) {
          const auto log_of = [&](Index d) {
            return std::log(static_cast<double>(p[at + d * P]) + kLeastProbability);
          };
          piece.sum -= w * ((1 - b.share) * log_of(b.lower) + b.share * log_of(b.upper));
          piece.weight += w;
        });
        return piece;
      });
  const double total = sums.total();
  return BasicVar<T>::record(
      "height_cross_entropy", BasicTensor<T>::scalar(static_cast<T>(sums.mean())), {probability},
      [=](Node<T>& n) {
        T* dp = n.grad_in(0);
        if (dp == nullptr) return;
        const T* values = n.in(0);
        const double factor = static_cast<double>(n.grad[0]) / total;
        for_range(count, kGrain, [&](Index begin, Index end) {
          each(begin, end, [&](Index at, const Bins& b, double w) {
            const auto add = [&](Index d, double q) {
              const Index k = at + d * P;
              dp[k] -= static_cast<T>(factor * w * q /
                                      (static_cast<double>(values[k]) + kLeastProbability));
            };
            add(b.lower, 1 - b.share);
            add(b.upper, b.share);
          });
        });
      });
}

template <class T>
BasicTensor<T> within_hypotheses(const BasicTensor<T>& heights, const BasicTensor<T>& truth,
                                 const BasicTensor<T>& weight) {
  Dims dim("within_hypotheses");
  dim.match("heights", heights, "B D H W")
      .match("truth", truth, "B H W")
      .match("weight", weight, "B H W");
  const Index D = dim["D"], P = dim["H"] * dim["W"];
  if (D == 0)
    throw ShapeError("within_hypotheses: heights has shape " + heights.shape().str() +
                     ", expected at least one hypothesis");
  BasicTensor<T> out = weight.clone();
  for_range(out.count(), 1 << 12, [&](Index begin, Index end) {
    for (Index i = begin; i < end; ++i)
      if (out[i] > 0 &&
          bins_of(heights.data() + i / P * D * P + i % P, D, P, static_cast<double>(truth[i]))
                  .lower < 0)
        out[i] = 0;
  });
  return out;
}

template Var height_cross_entropy(const Var&, const Tensor&, const Tensor&, const Tensor&);
template BasicVar<double> height_cross_entropy(const BasicVar<double>&, const BasicTensor<double>&,
                                               const BasicTensor<double>&,
                                               const BasicTensor<double>&);
template Tensor within_hypotheses(const Tensor&, const Tensor&, const Tensor&);
template BasicTensor<double> within_hypotheses(const BasicTensor<double>&,
                                               const BasicTensor<double>&,
                                               const BasicTensor<double>&);

}  // namespace satsurf

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/candidates.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/error.h"
#include "satsurf/core/parallel.h"
#include "satsurf/ops/weighted_sum.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <string>

namespace satsurf {
namespace {

constexpr Index kGrain = 1 << 12, kMost = 16;  // cells of a piece of work, candidates

/// The weights of one cell's candidates, 0 for those there are not.
struct Weights {
  std::array<double, kMost> w{};
  bool any = false;
};

/// Candidates alone say what there is: logits that are no numbers have to come out as such.
template <class T>
Weights weights_of(const T* logits, const T* candidates, Index K, Index P) {
  Weights out;
  double most = -INFINITY, sum = 0;
  for (Index k = 0; k < K; ++k)
    if (std::isfinite(candidates[k * P])) {
      out.any = true;
      most = std::max(most, static_cast<double>(logits[k * P]));
    }
  for (Index k = 0; k < K; ++k)
    if (std::isfinite(candidates[k * P]))
      sum += out.w[static_cast<std::size_t>(k)] =
          std::exp(static_cast<double>(logits[k * P]) - most);
  for (Index k = 0; k < K; ++k)
    if (std::isfinite(candidates[k * P])) out.w[static_cast<std::size_t>(k)] /= sum;
  return out;
}

/// Calls body(number, its height) for the candidates of one cell that there are.
template <class T, class Body>
void each_candidate(const T* candidates, Index K, Index P, const Body& body) {
  for (Index k = 0; k < K; ++k)
    if (const T z = candidates[k * P]; std::isfinite(z)) body(k, static_cast<double>(z));
}

/// Cells and candidates of a call.
struct Size {
  Index K, P;
};

template <class T>
Size size_of(const char* op, Dims& dim, const BasicVar<T>& logits,
             const BasicTensor<T>& candidates) {
  dim.match("logits", logits, "K H W").match("candidates", candidates, "K H W");
  if (dim["K"] > kMost)
    throw ShapeError(std::string(op) + ": candidates has shape " + candidates.shape().str() +
                     ", expected K of at most " + std::to_string(kMost));
  return {dim["K"], dim["H"] * dim["W"]};
}

/// The logarithm of a scale, within its limits.
double limited(double log_scale) { return std::clamp(log_scale, -4.0, 5.0); }

/// The target of a cell's weights; none where no candidate is near the truth.
template <class T>
Weights target_of(const T* candidates, Index K, Index P, double truth, double unit) {
  constexpr double kFar = 4;
  Weights out;
  double least = INFINITY, sum = 0;
  for (Index k = 0; k < K; ++k)
    if (std::isfinite(candidates[k * P]))
      least = std::min(least, std::abs(static_cast<double>(candidates[k * P]) - truth));
  if (!(least <= kFar * unit)) return out;
  out.any = true;
  for (Index k = 0; k < K; ++k)
    if (std::isfinite(candidates[k * P]))
      sum += out.w[static_cast<std::size_t>(k)] =
          std::exp((least - std::abs(static_cast<double>(candidates[k * P]) - truth)) / unit);
  for (double& q : out.w) q /= sum;
  return out;
}

}  // namespace

double laplace_scale(double log_scale, double unit) { return unit * std::exp(limited(log_scale)); }

template <class T>
BasicVar<T> chosen_height(const BasicVar<T>& logits, const BasicVar<T>& residual,
                          const BasicTensor<T>& candidates, double reach) {
  constexpr const char* kOp = "chosen_height";
  Dims dim(kOp);
  const auto [K, P] = size_of(kOp, dim, logits, candidates);
  dim.match("residual", residual, "H W");
  auto out = BasicTensor<T>::uninitialised(residual.shape());
  const T *l = logits.value().data(), *r = residual.value().data(), *z = candidates.data();
  for_range(P, kGrain, [&, K = K, P = P](Index begin, Index end) {
    for (Index i = begin; i < end; ++i) {
      const Weights weights = weights_of(l + i, z + i, K, P);
      double h = weights.any ? reach * std::tanh(static_cast<double>(r[i])) : 0;
      each_candidate(z + i, K, P,
                     [&](Index k, double at) { h += weights.w[static_cast<std::size_t>(k)] * at; });
      out[i] = static_cast<T>(h);
    }
  });
  return BasicVar<T>::record(
      kOp, std::move(out), {logits, residual}, [=, K = K, P = P](Node<T>& n) {
        T *dl = n.grad_in(0), *dr = n.grad_in(1);
        const T *logit = n.in(0), *rest = n.in(1), *heights = candidates.data(), *g = n.grad.data();
        for_range(P, kGrain, [&](Index begin, Index end) {
          for (Index i = begin; i < end; ++i) {
            const Weights weights = weights_of(logit + i, heights + i, K, P);
            if (!weights.any) continue;
            const double d = static_cast<double>(g[i]);
            if (dr != nullptr) {
              const double t = std::tanh(static_cast<double>(rest[i]));
              dr[i] += static_cast<T>(d * reach * (1 - t * t));
            }
            if (dl == nullptr) continue;
            double mean = 0;
            each_candidate(heights + i, K, P, [&](Index k, double at) {
              mean += weights.w[static_cast<std::size_t>(k)] * at;
            });
            each_candidate(heights + i, K, P, [&](Index k, double at) {
              dl[k * P + i] +=
                  static_cast<T>(d * weights.w[static_cast<std::size_t>(k)] * (at - mean));
            });
          }
        });
      });
}

template <class T>
BasicVar<T> laplace_loss(const BasicVar<T>& height, const BasicVar<T>& log_scale,
                         const BasicTensor<T>& truth, const BasicTensor<T>& weight, double unit) {
  Dims dim("laplace_loss");
  dim.match("height", height, "H W")
      .match("log_scale", log_scale, "H W")
      .match("truth", truth, "H W")
      .match("weight", weight, "H W");
  const Index P = truth.count();
  const T *h = height.value().data(), *s = log_scale.value().data();
  const WeightedSum sums = ordered_reduce(P, kGrain, WeightedSum{}, [&](Index begin, Index end) {
    WeightedSum piece;
    for (Index i = begin; i < end; ++i) {
      if (!(weight[i] > 0)) continue;
      const double w = static_cast<double>(weight[i]), log_b = limited(static_cast<double>(s[i])),
                   e = std::abs(static_cast<double>(h[i] - truth[i])) / unit;
      piece += {w * (e * std::exp(-log_b) + log_b + std::log(2.0)), w};
    }
    return piece;
  });
  return BasicVar<T>::record(
      "laplace_loss", BasicTensor<T>::scalar(static_cast<T>(sums.mean())), {height, log_scale},
      [=](Node<T>& n) {
        T *dh = n.grad_in(0), *ds = n.grad_in(1);
        const T *of = n.in(0), *scale = n.in(1);
        const double factor = static_cast<double>(n.grad[0]) / sums.total();
        for_range(P, kGrain, [&](Index begin, Index end) {
          for (Index i = begin; i < end; ++i) {
            if (!(weight[i] > 0)) continue;
            const double w = factor * static_cast<double>(weight[i]),
                         raw = static_cast<double>(scale[i]), log_b = limited(raw),
                         e = static_cast<double>(of[i] - truth[i]) / unit,
                         inverse = std::exp(-log_b);
            if (dh != nullptr && e != 0)
              dh[i] += static_cast<T>(w * (e > 0 ? inverse : -inverse) / unit);
            if (ds != nullptr && raw == log_b)
              ds[i] += static_cast<T>(w * (1 - std::abs(e) * inverse));
          }
        });
      });
}

namespace {

/// 1 where u is well above 0, 0 where it is well below; and its slope there.
struct SmoothStep {
  double value, slope;
};
SmoothStep smooth_step(double u) {
  constexpr double kWidth = 0.15;
  const double v = 1 / (1 + std::exp(-u / kWidth));
  return {v, v * (1 - v) / kWidth};
}

}  // namespace

template <class T>
BasicVar<T> sigma_loss(const BasicTensor<T>& height, const BasicVar<T>& log_scale,
                       const BasicTensor<T>& truth, const BasicTensor<T>& weight, double unit,
                       double times, double two) {
  Dims dim("sigma_loss");
  dim.match("height", height, "H W")
      .match("log_scale", log_scale, "H W")
      .match("truth", truth, "H W")
      .match("weight", weight, "H W");
  const Index P = truth.count();
  // of log(sigma / error)
  const auto loss_of = [=](Index i, double log_scale_of_i) -> SmoothStep {
    constexpr double kLeastError = 1e-9;  // units
    const double e = std::abs(static_cast<double>(height[i] - truth[i])) / unit,
                 u = limited(log_scale_of_i) + std::log(times / std::max(e, kLeastError));
    const SmoothStep within_one = smooth_step(u), within_two = smooth_step(u + std::log(2.0));
    return {within_one.value - two * within_two.value, within_one.slope - two * within_two.slope};
  };
  const T* s = log_scale.value().data();
  const WeightedSum sums = ordered_reduce(P, kGrain, WeightedSum{}, [&](Index begin, Index end) {
    WeightedSum piece;
    for (Index i = begin; i < end; ++i) {
      if (!(weight[i] > 0)) continue;
      const auto w = static_cast<double>(weight[i]);
      piece += {w * loss_of(i, static_cast<double>(s[i])).value, w};
    }
    return piece;
  });
  return BasicVar<T>::record("sigma_loss", BasicTensor<T>::scalar(static_cast<T>(sums.mean())),
                             {log_scale}, [=](Node<T>& n) {
                               T* ds = n.grad_in(0);
                               const T* scale = n.in(0);
                               const double factor = static_cast<double>(n.grad[0]) / sums.total();
                               for_range(P, kGrain, [&](Index begin, Index end) {
                                 for (Index i = begin; i < end; ++i) {
                                   const auto raw = static_cast<double>(scale[i]);
                                   if (!(weight[i] > 0) || raw != limited(raw)) continue;
                                   ds[i] += static_cast<T>(factor * static_cast<double>(weight[i]) *
                                                           loss_of(i, raw).slope);
                                 }
                               });
                             });
}

template <class T>
BasicVar<T> candidate_cross_entropy(const BasicVar<T>& logits, const BasicTensor<T>& candidates,
                                    const BasicTensor<T>& truth, const BasicTensor<T>& weight,
                                    double unit) {
  constexpr const char* kOp = "candidate_cross_entropy";
  Dims dim(kOp);
  const auto [K, P] = size_of(kOp, dim, logits, candidates);
  dim.match("truth", truth, "H W").match("weight", weight, "H W");
  // body(cell, its weights, their target, what it counts)
  const auto each = [=, K = K, P = P](const T* l, Index begin, Index end, const auto& body) {
    for (Index i = begin; i < end; ++i) {
      if (!(weight[i] > 0)) continue;
      const Weights q = target_of(candidates.data() + i, K, P, static_cast<double>(truth[i]), unit);
      if (q.any)
        body(i, weights_of(l + i, candidates.data() + i, K, P), q, static_cast<double>(weight[i]));
    }
  };
  constexpr double kLeast = 1e-12;
  const T* l = logits.value().data();
  const WeightedSum sums = ordered_reduce(P, kGrain, WeightedSum{}, [&](Index begin, Index end) {
    WeightedSum piece;
    each(l, begin, end, [&](Index, const Weights& p, const Weights& q, double w) {
      for (std::size_t k = 0; k < kMost; ++k)
        if (q.w[k] > 0) piece.sum -= w * q.w[k] * std::log(p.w[k] + kLeast);
      piece.weight += w;
    });
    return piece;
  });
  return BasicVar<T>::record(
      kOp, BasicTensor<T>::scalar(static_cast<T>(sums.mean())), {logits},
      [=, K = K, P = P](Node<T>& n) {
        T* dl = n.grad_in(0);
        if (dl == nullptr) return;
        const double factor = static_cast<double>(n.grad[0]) / sums.total();
        for_range(P, kGrain, [&](Index begin, Index end) {
          each(n.in(0), begin, end, [&](Index i, const Weights& p, const Weights& q, double w) {
            // d(-sum q log(p + e))/dl_k = p_k sum_j q_j p_j / (p_j + e) - q_k p_k / (p_k + e)
            double sum = 0;
            for (std::size_t k = 0; k < kMost; ++k) sum += q.w[k] * p.w[k] / (p.w[k] + kLeast);
            each_candidate(candidates.data() + i, K, P, [&](Index k, double) {
              const auto at = static_cast<std::size_t>(k);
              dl[k * P + i] += static_cast<T>(
                  factor * w * (p.w[at] * sum - q.w[at] * p.w[at] / (p.w[at] + kLeast)));
            });
          });
        });
      });
}

#define SATSURF_CANDIDATES(T)                                                                      \
  template BasicVar<T> chosen_height(const BasicVar<T>&, const BasicVar<T>&,                       \
                                     const BasicTensor<T>&, double);                               \
  template BasicVar<T> laplace_loss(const BasicVar<T>&, const BasicVar<T>&, const BasicTensor<T>&, \
                                    const BasicTensor<T>&, double);                                \
  template BasicVar<T> sigma_loss(const BasicTensor<T>&, const BasicVar<T>&,                       \
                                  const BasicTensor<T>&, const BasicTensor<T>&, double, double,    \
                                  double);                                                         \
  template BasicVar<T> candidate_cross_entropy(const BasicVar<T>&, const BasicTensor<T>&,          \
                                               const BasicTensor<T>&, const BasicTensor<T>&,       \
                                               double)
SATSURF_CANDIDATES(float);
SATSURF_CANDIDATES(double);
#undef SATSURF_CANDIDATES

}  // namespace satsurf

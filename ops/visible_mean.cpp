// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/visible_mean.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"

#include <cmath>
#include <string>
#include <vector>

namespace satsurf {
namespace {

constexpr Index kGrain = 256;    // pixels
constexpr double kLeast = 1e-4;  // e

/// Extents, and where a piece of the pixels begins and ends.
struct Piece {
  Index J, K, D, P, begin, end;
  Index count() const { return end - begin; }
  /// Where the piece begins in channel k of pair j at hypothesis d.
  Index at(Index j, Index k, Index d) const { return ((j * (K + 1) + k) * D + d) * P + begin; }
};

/// How visible the pixels of a piece are in each view, and at which hypothesis; -1 for none.
template <class T>
struct Visibility {
  std::vector<T> of;      ///< [J count] v_j
  std::vector<T> slope;   ///< [J count] its derivative by the logit
  std::vector<Index> at;  ///< [J count]

  Visibility(const Piece& p, const T* costs, const T* logits)
      : of(static_cast<std::size_t>(p.J * p.count()), T(0)),
        slope(of.size(), T(0)),
        at(of.size(), -1) {
    for (Index j = 0; j < p.J; ++j)
      for (Index d = 0; d < p.D; ++d) {
        const T *seen = costs + p.at(j, p.K, d), *l = logits + (j * p.D + d) * p.P + p.begin;
        for (Index i = 0; i < p.count(); ++i) {
          const auto n = static_cast<std::size_t>(j * p.count() + i);
          if (!(seen[i] > 0) || (at[n] >= 0 && !(l[i] > of[n]))) continue;
          of[n] = l[i];
          at[n] = d;
        }
      }
    for (std::size_t n = 0; n < of.size(); ++n) {
      if (at[n] < 0) continue;
      const T s = 1 / (1 + std::exp(-of[n])), share = static_cast<T>(1 - kLeast);
      of[n] = static_cast<T>(kLeast) + share * s;
      slope[n] = share * s * (1 - s);
    }
  }
};

/// Calls body(n of Visibility, index in [J K+1 D H W] of the pair's first cost) for the views that see
/// pixel i of the piece at hypothesis d.
template <class T>
void each_seeing(const Piece& p, const T* costs, Index d, Index i, const auto& body) {
  for (Index j = 0; j < p.J; ++j)
    if (costs[p.at(j, p.K, d) + i] > 0)
      body(static_cast<std::size_t>(j * p.count() + i), p.at(j, 0, d) + i);
}

template <class T>
T sum_of(const Piece& p, const T* costs, const Visibility<T>& v, Index d, Index i) {
  T sum = 0;
  each_seeing(p, costs, d, i, [&](std::size_t n, Index) { sum += v.of[n]; });
  return sum;
}

template <class T>
void forward(const Piece& p, const T* costs, const T* logits, T* out) {
  const Visibility<T> v(p, costs, logits);
  const Index channel = p.D * p.P;
  for (Index d = 0; d < p.D; ++d)
    for (Index i = 0; i < p.count(); ++i) {
      T* const to = out + p.at(0, 0, d) + i;
      for (Index k = 0; k <= p.K; ++k) to[k * channel] = 0;
      const T sum = sum_of(p, costs, v, d, i);
      if (!(sum > 0)) continue;
      each_seeing(p, costs, d, i, [&](std::size_t n, Index from) {
        for (Index k = 0; k < p.K; ++k)
          to[k * channel] += v.of[n] / sum * costs[from + k * channel];
      });
      to[p.K * channel] = sum / static_cast<T>(p.J);
    }
}

/// d_costs, d_logits  take gradients, or nullptr
template <class T>
void backward(const Piece& p, const T* costs, const T* logits, const T* out, const T* g, T* d_costs,
              T* d_logits) {
  const Visibility<T> v(p, costs, logits);
  const Index channel = p.D * p.P;
  std::vector<T> d_v(v.of.size(), T(0));
  for (Index d = 0; d < p.D; ++d)
    for (Index i = 0; i < p.count(); ++i) {
      const Index at = p.at(0, 0, d) + i;
      const T sum = sum_of(p, costs, v, d, i);
      if (!(sum > 0)) continue;
      each_seeing(p, costs, d, i, [&](std::size_t n, Index from) {
        for (Index k = 0; k < p.K; ++k) {
          const Index o = at + k * channel, c = from + k * channel;
          if (d_costs != nullptr) d_costs[c] += v.of[n] / sum * g[o];
          d_v[n] += (costs[c] - out[o]) / sum * g[o];
        }
        d_v[n] += g[at + p.K * channel] / static_cast<T>(p.J);
      });
    }
  if (d_logits == nullptr) return;
  for (Index j = 0; j < p.J; ++j)
    for (Index i = 0; i < p.count(); ++i) {
      const auto n = static_cast<std::size_t>(j * p.count() + i);
      if (v.at[n] >= 0) d_logits[(j * p.D + v.at[n]) * p.P + p.begin + i] += d_v[n] * v.slope[n];
    }
}

}  // namespace

template <class T>
BasicVar<T> visible_mean(const BasicVar<T>& costs, const BasicVar<T>& logits) {
  Dims dim("visible_mean");
  dim.match("costs", costs, "J C D H W").match("logits", logits, "J L D H W");
  if (dim["C"] < 2 || dim["L"] != 1)
    throw ShapeError("visible_mean: costs have shape " + costs.shape().str() + ", logits " +
                     logits.shape().str() + ", expected two channels or more, and one");
  const Index H = dim["H"], W = dim["W"];
  const Piece all{dim["J"], dim["C"] - 1, dim["D"], H * W, 0, H * W};
  const auto piece = [all](Index begin, Index end) {
    Piece p = all;
    p.begin = begin;
    p.end = end;
    return p;
  };
  auto out = BasicTensor<T>::uninitialised({all.K + 1, all.D, H, W});
  for_range(all.P, kGrain, [&](Index begin, Index end) {
    forward(piece(begin, end), costs.value().data(), logits.value().data(), out.data());
  });
  return BasicVar<T>::record("visible_mean", out, {costs, logits}, [piece, out](Node<T>& n) {
    T *d_costs = n.grad_in(0), *d_logits = n.grad_in(1);
    for_range(piece(0, 0).P, kGrain, [&](Index begin, Index end) {
      backward(piece(begin, end), n.in(0), n.in(1), out.data(), n.grad.data(), d_costs, d_logits);
    });
  });
}

template BasicVar<float> visible_mean(const BasicVar<float>&, const BasicVar<float>&);
template BasicVar<double> visible_mean(const BasicVar<double>&, const BasicVar<double>&);

}  // namespace satsurf

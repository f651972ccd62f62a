// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/norm.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

namespace satsurf {
namespace {

constexpr Index kChunk = 1 << 14;  // elements whose sums are taken together

/// x as rows (b, c) of S positions, cut into chunks.
struct Layout {
  Index B, C, S, G, chunks;

  Index rows() const { return B * C; }
  Index per_group() const { return C / G * S; }
  /// body(row, chunk, begin, end) with the element range in x; chunks are grouped into pieces.
  template <class Body>
  void each_chunk(const Body& body) const {
    const Index grain = std::max<Index>(1, kChunk / std::max<Index>(1, std::min(S, kChunk)));
    for_range(rows() * chunks, grain, [&](Index first, Index last) {
      for (Index k = first; k < last; ++k) {
        const Index row = k / chunks, begin = k % chunks * kChunk;
        body(row, k, row * S + begin, row * S + std::min(S, begin + kChunk));
      }
    });
  }
};

struct Pair {
  double a = 0, b = 0;
};
std::size_t at(Index i) { return static_cast<std::size_t>(i); }

template <class T>
T activate(Activation activation, T z) {
  if (activation == Activation::relu) return z > 0 ? z : T(0);
  if (activation == Activation::gelu) return T(0.5) * z * std::erfc(-z * T(0.70710678118654752440));
  return z;
}

template <class T>
T activation_slope(Activation activation, T z) {
  if (activation == Activation::relu) return z > 0 ? T(1) : T(0);
  if (activation == Activation::gelu)
    return T(0.5) * std::erfc(-z * T(0.70710678118654752440)) +
           z * T(0.39894228040143267794) * std::exp(T(-0.5) * z * z);
  return T(1);
}

}  // namespace

template <class T>
BasicVar<T> group_norm(const BasicVar<T>& x, const BasicVar<T>& gamma, const BasicVar<T>& beta,
                       Index groups, Activation activation, T epsilon) {
  const Shape& s = x.shape();
  if (s.rank() < 3 || s.count() == 0)
    throw ShapeError("group_norm: x has shape " + s.str() +
                     ", expected a non-empty [B C ...] of rank 3 to 5");
  Dims dim("group_norm");
  dim.match("x", Shape{s[1]}, "C").match("gamma", gamma, "C").match("beta", beta, "C");
  if (groups < 1 || s[1] % groups != 0)
    throw ShapeError("group_norm: " + std::to_string(groups) + " groups, expected a divisor of " +
                     std::to_string(s[1]) + " channels");
  const Index S = s.count(2, s.rank());
  const Layout lay{s[0], s[1], S, groups, (S + kChunk - 1) / kChunk};
  const Index C = lay.C, G = lay.G, group_channels = C / G;

  // Moments about the group's first element: one pass, and no cancellation where the mean is large.
  std::vector<Pair> sums(at(lay.rows() * lay.chunks));
  const T* px = x.value().data();
  lay.each_chunk([&](Index row, Index k, Index begin, Index end) {
    const double shift = static_cast<double>(px[row / group_channels * group_channels * S]);
    Pair p;
    for (Index i = begin; i < end; ++i) {
      const double e = static_cast<double>(px[i]) - shift;
      p.a += e;
      p.b += e * e;
    }
    sums[at(k)] = p;
  });
  std::vector<T> mean(at(lay.B * G)), rstd(at(lay.B * G));
  for (Index q = 0; q < lay.B * G; ++q) {
    Pair p;
    for (Index k = q * group_channels * lay.chunks; k < (q + 1) * group_channels * lay.chunks;
         ++k) {
      p.a += sums[at(k)].a;
      p.b += sums[at(k)].b;
    }
    const double M = static_cast<double>(lay.per_group()), m = p.a / M;
    const double variance = std::max(0.0, p.b / M - m * m);
    mean[at(q)] = static_cast<T>(m + static_cast<double>(px[q * lay.per_group()]));
    rstd[at(q)] = static_cast<T>(1 / std::sqrt(variance + static_cast<double>(epsilon)));
  }

  auto out = BasicTensor<T>::uninitialised(s);
  lay.each_chunk([&](Index row, Index, Index begin, Index end) {
    const Index c = row % C, q = row / group_channels;
    const T m = mean[at(q)], r = rstd[at(q)], ga = gamma.value()[c], be = beta.value()[c];
    for (Index i = begin; i < end; ++i) out[i] = activate(activation, (px[i] - m) * r * ga + be);
  });

  return BasicVar<T>::record("group_norm", out, {x, gamma, beta}, [=](Node<T>& n) {
    const T *g = n.grad.data(), *v = n.in(0), *ga = n.in(1), *be = n.in(2);
    T *dx = n.grad_in(0), *dgamma = n.grad_in(1), *dbeta = n.grad_in(2);
    std::vector<Pair> part(at(lay.rows() * lay.chunks));  // sums of dz and of dz x_hat
    const auto dz = [=](Index i, Index c, T x_hat) {
      return g[i] * activation_slope(activation, x_hat * ga[c] + be[c]);
    };
    lay.each_chunk([&](Index row, Index k, Index begin, Index end) {
      const Index c = row % C, q = row / group_channels;
      Pair p;
      for (Index i = begin; i < end; ++i) {
        const T x_hat = (v[i] - mean[at(q)]) * rstd[at(q)], d = dz(i, c, x_hat);
        p.a += static_cast<double>(d);
        p.b += static_cast<double>(d * x_hat);
      }
      part[at(k)] = p;
    });
    std::vector<Pair> row_sum(at(lay.rows())), group_mean(at(lay.B * G));
    for (Index row = 0; row < lay.rows(); ++row) {
      Pair& p = row_sum[at(row)];
      for (Index k = row * lay.chunks; k < (row + 1) * lay.chunks; ++k) {
        p.a += part[at(k)].a;
        p.b += part[at(k)].b;
      }
      const double scale = static_cast<double>(ga[row % C]) / static_cast<double>(lay.per_group());
      group_mean[at(row / group_channels)].a += scale * p.a;
      group_mean[at(row / group_channels)].b += scale * p.b;
    }
    for (Index c = 0; c < C; ++c) {
      Pair p;
      for (Index b = 0; b < lay.B; ++b) {
        p.a += row_sum[at(b * C + c)].a;
        p.b += row_sum[at(b * C + c)].b;
      }
      if (dbeta != nullptr) dbeta[c] += static_cast<T>(p.a);
      if (dgamma != nullptr) dgamma[c] += static_cast<T>(p.b);
    }
    if (dx == nullptr) return;
    lay.each_chunk([&](Index row, Index, Index begin, Index end) {
      const Index c = row % C, q = row / group_channels;
      const T m1 = static_cast<T>(group_mean[at(q)].a), m2 = static_cast<T>(group_mean[at(q)].b);
      for (Index i = begin; i < end; ++i) {
        const T x_hat = (v[i] - mean[at(q)]) * rstd[at(q)];
        dx[i] += rstd[at(q)] * (ga[c] * dz(i, c, x_hat) - m1 - x_hat * m2);
      }
    });
  });
}

template BasicVar<float> group_norm(const BasicVar<float>&, const BasicVar<float>&,
                                    const BasicVar<float>&, Index, Activation, float);
template BasicVar<double> group_norm(const BasicVar<double>&, const BasicVar<double>&,
                                     const BasicVar<double>&, Index, Activation, double);

}  // namespace satsurf

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/norm.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/isa.h"
#include "satsurf/core/parallel.h"
#include "satsurf/ops/pointwise_kernels.h"

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

/// Two sums that are always taken together; the kernels write them side by side.
struct Pair {
  double value[2] = {0, 0};
  Pair& operator+=(const Pair& o) {
    value[0] += o.value[0];
    value[1] += o.value[1];
    return *this;
  }
};
std::size_t at(Index i) { return static_cast<std::size_t>(i); }

}  // namespace

template <class T>
BasicVar<T> group_norm(BasicVar<T> x, const BasicVar<T>& gamma, const BasicVar<T>& beta,
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
  const auto add_up = SATSURF_DISPATCH(norm_sums<T>);
  lay.each_chunk([&](Index row, Index k, Index begin, Index end) {
    add_up(end - begin, px + begin, px[row / group_channels * group_channels * S],
           sums[at(k)].value);
  });
  std::vector<T> rstd(at(lay.B * G)), shift(at(lay.B * G));  // x_hat = rstd x + shift
  for (Index q = 0; q < lay.B * G; ++q) {
    Pair p;
    for (Index k = q * group_channels * lay.chunks; k < (q + 1) * group_channels * lay.chunks; ++k)
      p += sums[at(k)];
    const double M = static_cast<double>(lay.per_group()), m = p.value[0] / M;
    const double variance = std::max(0.0, p.value[1] / M - m * m);
    const double r = 1 / std::sqrt(variance + static_cast<double>(epsilon));
    rstd[at(q)] = static_cast<T>(r);
    shift[at(q)] = static_cast<T>(-r * (m + static_cast<double>(px[q * lay.per_group()])));
  }

  auto out = x.reuse_or_new();
  const auto apply = SATSURF_DISPATCH(norm_apply<T>);
  lay.each_chunk([&](Index row, Index, Index begin, Index end) {
    const Index c = row % C, q = row / group_channels;
    const NormRow<T> r{rstd[at(q)], shift[at(q)], gamma.value()[c], beta.value()[c]};
    apply(end - begin, px + begin, r, activation, out.data() + begin);
  });

  return BasicVar<T>::record("group_norm", out, {x, gamma, beta}, [=](Node<T>& n) {
    const T *g = n.grad.data(), *v = n.in(0), *ga = n.in(1), *be = n.in(2);
    T *dx = n.grad_in(0), *dgamma = n.grad_in(1), *dbeta = n.grad_in(2);
    const auto row_of = [&](Index row) {
      const Index c = row % C, q = row / group_channels;
      return NormRow<T>{rstd[at(q)], shift[at(q)], ga[c], be[c]};
    };
    // dz = g act'(z): GELU's slope is dear, so it is kept for the second pass; ReLU's is a
    // comparison.
    BasicTensor<T> kept;
    if (dx != nullptr && activation == Activation::gelu)
      kept = BasicTensor<T>::uninitialised(n.value.shape());
    std::vector<Pair> part(at(lay.rows() * lay.chunks));  // sums of dz and of dz x_hat
    const auto slopes = SATSURF_DISPATCH(norm_slopes<T>);
    lay.each_chunk([&](Index row, Index k, Index begin, Index end) {
      slopes(end - begin, v + begin, g + begin, row_of(row), activation,
             kept.empty() ? nullptr : kept.data() + begin, part[at(k)].value);
    });
    std::vector<Pair> row_sum(at(lay.rows())), group_mean(at(lay.B * G));
    for (Index row = 0; row < lay.rows(); ++row) {
      for (Index k = row * lay.chunks; k < (row + 1) * lay.chunks; ++k)
        row_sum[at(row)] += part[at(k)];
      const double scale = static_cast<double>(ga[row % C]) / static_cast<double>(lay.per_group());
      for (std::size_t m = 0; m < 2; ++m)
        group_mean[at(row / group_channels)].value[m] += scale * row_sum[at(row)].value[m];
    }
    for (Index c = 0; c < C; ++c) {
      Pair p;
      for (Index b = 0; b < lay.B; ++b) p += row_sum[at(b * C + c)];
      if (dbeta != nullptr) dbeta[c] += static_cast<T>(p.value[0]);
      if (dgamma != nullptr) dgamma[c] += static_cast<T>(p.value[1]);
    }
    if (dx == nullptr) return;
    const T* dz = kept.empty() ? g : kept.data();
    const auto gradient = SATSURF_DISPATCH(norm_gradient<T>);
    lay.each_chunk([&](Index row, Index, Index begin, Index end) {
      // dx = rstd (gamma dz - mean(gamma dz) - x_hat mean(gamma dz x_hat)), means over the group
      const NormRow<T> r = row_of(row);
      const auto& m = group_mean[at(row / group_channels)].value;
      gradient(end - begin, v + begin, dz + begin, r, activation == Activation::relu,
               r.rstd * r.gamma, -r.rstd * static_cast<T>(m[1]), -r.rstd * static_cast<T>(m[0]),
               dx + begin);
    });
  });
}

template BasicVar<float> group_norm(BasicVar<float>, const BasicVar<float>&, const BasicVar<float>&,
                                    Index, Activation, float);
template BasicVar<double> group_norm(BasicVar<double>, const BasicVar<double>&,
                                     const BasicVar<double>&, Index, Activation, double);

}  // namespace satsurf

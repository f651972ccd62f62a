// SPDX-License-Identifier: Apache-2.0
#include "satsurf/ops/norm.h"

#include "satsurf/core/dims.h"

#include <cmath>
#include <string>
#include <utility>
#include <vector>

namespace satsurf {
namespace {

/// What one group of one image is normalised by.
struct Group {
  double count, mean, rstd;
};

std::vector<Group> groups_of(const ChannelMoments& moments, Index channels, double epsilon) {
  std::vector<Group> out(moments.size() / channels);
  for (std::size_t q = 0; q < out.size(); ++q) {
    Moments m;
    for (Index c = 0; c < channels; ++c) m.merge(moments[q * channels + c]);
    out[q] = {m.count, m.mean, 1 / std::sqrt(m.m2 / m.count + epsilon)};
  }
  return out;
}

}  // namespace

template <class T>
Normalised<T> group_normalised(const BasicVar<T>& x, const BasicVar<T>& gamma,
                               const BasicVar<T>& beta, Index groups, Activation activation,
                               T epsilon, const ChannelMoments* moments) {
  const Shape& s = x.shape();
  if (s.rank() < 3 || s.count() == 0)
    throw ShapeError("group_normalised: x has shape " + s.str() +
                     ", expected a non-empty [B C ...] of rank 3 to 5");
  Dims dim("group_normalised");
  dim.match("x", Shape{s[1]}, "C").match("gamma", gamma, "C").match("beta", beta, "C");
  if (groups < 1 || s[1] % groups != 0)
    throw ShapeError("group_normalised: " + std::to_string(groups) +
                     " groups, expected a divisor of " + std::to_string(s[1]) + " channels");
  const Index B = s[0], C = s[1], per_group = C / groups;
  if (moments != nullptr && std::ssize(*moments) != B * C)
    throw ShapeError("group_normalised: " + std::to_string(moments->size()) +
                     " moments, expected one for each channel of " + s.str());
  const std::vector<Group> group =
      groups_of(moments == nullptr ? channel_moments(x.value()) : *moments, per_group, epsilon);

  auto affine = BasicTensor<T>::uninitialised({3, B, C});
  for (Index row = 0; row < B * C; ++row) {
    const Group& g = group[row / per_group];
    affine[row] = static_cast<T>(g.mean);
    affine[B * C + row] = static_cast<T>(gamma.value()[row % C] * g.rstd);
    affine[2 * B * C + row] = beta.value()[row % C];
  }
  auto coefficients = BasicVar<T>::record(
      "group_normalised", affine, {x, gamma, beta}, [group, B, C, per_group](Node<T>& n) {
        const T *g = n.grad.data(), *ga = n.in(1);
        T *dx = n.grad_in(0), *dgamma = n.grad_in(1), *dbeta = n.grad_in(2);
        std::vector<double> dmean(group.size()), drstd(group.size());
        for (Index row = 0; row < B * C; ++row) {
          const std::size_t q = row / per_group;
          const Index c = row % C;
          const double dscale = g[B * C + row];
          dmean[q] += g[row];
          drstd[q] += ga[c] * dscale;
          if (dgamma != nullptr) dgamma[c] += static_cast<T>(group[q].rstd * dscale);
          if (dbeta != nullptr) dbeta[c] += g[2 * B * C + row];
        }
        if (dx == nullptr) return;
        // mean = sum(x) / M and rstd = (sum((x - mean)^2) / M + epsilon)^(-1/2)
        auto linear = BasicTensor<T>::uninitialised({3, B, C});
        for (Index row = 0; row < B * C; ++row) {
          const std::size_t q = row / per_group;
          const Group& own = group[q];
          linear[row] = static_cast<T>(own.mean);
          linear[B * C + row] = static_cast<T>(-std::pow(own.rstd, 3) * drstd[q] / own.count);
          linear[2 * B * C + row] = static_cast<T>(dmean[q] / own.count);
        }
        detail::add_affine(n.inputs[0]->value, linear, dx);
      });
  return {x, coefficients, activation};
}

template Normalised<float> group_normalised(const BasicVar<float>&, const BasicVar<float>&,
                                            const BasicVar<float>&, Index, Activation, float,
                                            const ChannelMoments*);
template Normalised<double> group_normalised(const BasicVar<double>&, const BasicVar<double>&,
                                             const BasicVar<double>&, Index, Activation, double,
                                             const ChannelMoments*);
}  // namespace satsurf

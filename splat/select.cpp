// SPDX-License-Identifier: Apache-2.0
#include "satsurf/splat/select.h"

#include "satsurf/ops/concat.h"

#include <algorithm>

namespace satsurf::splat {
namespace {

/// Rows of `t` ([P ...]) named by `keep`.
Tensor rows_of(const Tensor& t, const std::vector<Index>& keep) {
  const Index n = std::ssize(keep), width = t.dim(0) > 0 ? t.count() / t.dim(0) : 0;
  auto out = Tensor::uninitialised(t.shape().with(0, n));
  for (Index i = 0; i < n; ++i)
    std::copy_n(t.data() + keep[i] * width, width, out.data() + i * width);
  return out;
}

}  // namespace

template <class T>
BasicSurfels<T> joined(const std::vector<BasicSurfels<T>>& parts) {
  if (parts.size() == 1) return parts[0];
  const auto join = [&](BasicVar<T> BasicSurfels<T>::*member) {
    std::vector<BasicVar<T>> list;
    for (const auto& p : parts) list.push_back(p.*member);
    return concat(list, 0);
  };
  using S = BasicSurfels<T>;
  return {join(&S::means),   join(&S::quats),   join(&S::scales),
          join(&S::opacity), join(&S::colours), join(&S::aux)};
}

Surfels selected(const Surfels& s, const std::vector<Index>& keep) {
  const auto take = [&](const Var& v) { return Var(rows_of(v.value(), keep)); };
  return {take(s.means),   take(s.quats),   take(s.scales),
          take(s.opacity), take(s.colours), take(s.aux)};
}

template BasicSurfels<float> joined(const std::vector<BasicSurfels<float>>&);
template BasicSurfels<double> joined(const std::vector<BasicSurfels<double>>&);

}  // namespace satsurf::splat

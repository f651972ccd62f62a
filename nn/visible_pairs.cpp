// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/visible_pairs.h"

#include "satsurf/ops/concat.h"
#include "satsurf/ops/visible_mean.h"

#include <algorithm>

namespace satsurf::nn {
namespace {

constexpr Index kHidden = 8;

}  // namespace

template <class T>
VisiblePairs<T>::VisiblePairs(ParameterSet<T>& p, const std::string& name)
    : hidden_(p, name + ".hidden", kPairChannels, kHidden, 1),
      weight_(p.create(name + ".logit.weight", {1, kHidden, 3, 3, 3}, Init::kaiming(kHidden * 27),
                       true)) {}

template <class T>
BasicVar<T> VisiblePairs<T>::operator()(const BasicVar<T>& features, Index reference,
                                        const std::vector<Quadratic>& maps,
                                        const BasicTensor<T>& heights,
                                        const BasicTensor<T>& valid) const {
  const Index N = features.dim(0), C = features.dim(1), H = features.dim(2), W = features.dim(3);
  const auto of_pair = [&](Index j) {
    BasicTensor<T> both;
    if (!valid.empty()) {
      both = BasicTensor<T>::uninitialised({2, H, W});
      std::copy_n(valid.data() + reference * H * W, H * W, both.data());
      std::copy_n(valid.data() + j * H * W, H * W, both.data() + H * W);
    }
    // Of two views the best pair is the only one.
    const BasicVar<T> volume = plane_sweep_variance(
        concat<T>({slice(features, 0, reference, reference + 1), slice(features, 0, j, j + 1)}, 0),
        0, {maps[static_cast<std::size_t>(reference)], maps[static_cast<std::size_t>(j)]}, heights,
        both, {.best_pair = true});
    const BasicVar<T> costs = slice(volume, 0, C, C + kPairChannels);
    return reshape(costs, Shape{1, kPairChannels, costs.dim(1), H, W});
  };
  std::vector<BasicVar<T>> pairs;
  for (Index j = 0; j < N; ++j)
    if (j != reference) pairs.push_back(of_pair(j));
  const BasicVar<T> costs = concat(pairs, 0);
  return visible_mean(costs, conv3d(hidden_(costs), weight_, {}, {.padding = {1, 1, 1}}));
}

template class VisiblePairs<float>;
template class VisiblePairs<double>;

}  // namespace satsurf::nn

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/cost_net.h"

#include "satsurf/ops/concat.h"
#include "satsurf/ops/elementwise.h"

#include <utility>

namespace satsurf::nn {

template <class T>
CostNet<T>::CostNet(ParameterSet<T>& p, const std::string& name, const CostNetOptions& options)
    : first_(p, name + ".first", options.channels, options.base, 1) {
  const Index base = options.base;
  if (options.more > 0)
    more_ = p.create(name + ".first.more", {base, options.more, 3, 3, 3}, Init::constant(0), true);
  for (Index l = 0; l < options.levels; ++l) {
    const std::string level = name + ".level" + std::to_string(l + 1);
    const Index c = base << l;
    levels_.push_back(Level{ConvNorm3d<T>(p, level + ".down", c, 2 * c, 2),
                            ConvNorm3d<T>(p, level + ".same", 2 * c, 2 * c, 1),
                            UpNorm3d<T>(p, level + ".up", 2 * c, c)});
  }
  if (options.context == Context::reference) {
    context_.emplace(p, name + ".context", options.channels, 2 * base, 4, 2, Activation::none);
    context_->gamma.mutable_value().fill(T(0));  // matching comes first
  }
  last_ = p.create(name + ".logit.weight", {1, base, 3, 3, 3}, Init::kaiming(base * 27), true);
}

template <class T>
BasicVar<T> CostNet<T>::operator()(BasicVar<T> volume, const BasicVar<T>& features,
                                   const std::function<void()>& poll) const {
  const auto polled = [&poll](Normalised<T> x) {
    if (poll) poll();
    return x;
  };
  const Index C = volume.dim(0), D = volume.dim(1), H = volume.dim(2), W = volume.dim(3);
  // The volume is the largest tensor of all: without a tape it goes as soon as it has been read.
  std::vector<Normalised<T>> skips;
  const BasicVar<T> weight = more_ ? concat<T>({first_.weight, *more_}, 1) : first_.weight;
  skips.push_back(
      polled(first_.apply(reshape(std::exchange(volume, {}), Shape{1, C, D, H, W}), weight)));
  for (const Level& l : levels_) {
    Normalised<T> down = polled(l.down(skips.back()));
    if (context_ && skips.size() == 1)
      down = add_map(std::move(down), materialise((*context_)(features)));
    skips.push_back(polled(l.same(down)));
  }
  Normalised<T> x = std::move(skips.back());
  for (std::size_t l = levels_.size(); l-- > 0;)
    x = add(std::move(skips[l]), polled(levels_[l].up(x)));
  return reshape(conv3d(x, last_, {}, {.padding = {1, 1, 1}}), Shape{1, D, H, W});
}

template class CostNet<float>;
template class CostNet<double>;

}  // namespace satsurf::nn

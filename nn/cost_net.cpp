// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/cost_net.h"

#include "satsurf/core/parallel.h"
#include "satsurf/ops/concat.h"
#include "satsurf/ops/elementwise.h"

#include <algorithm>
#include <utility>

namespace satsurf::nn {

Index band_rows(Index row) {
  constexpr Index kNumbers = Index{10} << 20, kFewest = 16;
  return std::max(kFewest, kNumbers / row);
}

template <class T>
CostNet<T>::CostNet(ParameterSet<T>& p, const std::string& name, const CostNetOptions& options)
    : first_(p, name + ".first", options.channels, options.base, 1) {
  const Index base = options.base;
  if (options.more > 0)
    more_ = p.create(name + ".first.more", {base, options.more, 3, 3, 3}, Init::constant(0), true);
  if (options.pairs > 0)
    pairs_ =
        p.create(name + ".first.pairs", {base, options.pairs, 3, 3, 3}, Init::constant(0), true);
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
BasicVar<T> CostNet<T>::first_weight() const {
  std::vector<BasicVar<T>> parts{first_.weight};
  if (more_) parts.push_back(*more_);
  if (pairs_) parts.push_back(*pairs_);
  return parts.size() > 1 ? concat(parts, 1) : first_.weight;
}

template <class T>
BasicVar<T> CostNet<T>::operator()(BasicVar<T> volume, const BasicVar<T>& features,
                                   const std::function<void()>& poll) const {
  const Index C = volume.dim(0), D = volume.dim(1), H = volume.dim(2), W = volume.dim(3);
  // The volume is the largest tensor of all: without a tape it goes as soon as it has been read.
  return after_first(
      first_.apply(reshape(std::exchange(volume, {}), Shape{1, C, D, H, W}), first_weight()),
      features, poll);
}

template <class T>
BasicVar<T> CostNet<T>::operator()(const PlaneSweep<T>& sweep, const BasicVar<T>& features,
                                   const std::function<void()>& poll) const {
  const NoGrad no_grad;
  return after_first(first_of(sweep, poll), features, poll);
}

template <class T>
Normalised<T> CostNet<T>::first_of(const PlaneSweep<T>& sweep,
                                   const std::function<void()>& poll) const {
  const Shape& of = sweep.shape();
  const Index C = of[0], D = of[1], H = of[2], W = of[3];
  const BasicVar<T> weight = first_weight();
  const Index O = weight.dim(0), rows = std::min(H, band_rows(C * D * W));
  auto out = BasicTensor<T>::uninitialised({1, O, D, H, W});
  ChannelMoments moments(static_cast<std::size_t>(O));
  BasicTensor<T> before;  // the band above, whose last two rows are needed once more
  for (Index first = 0; first < H; first += rows) {
    if (poll) poll();
    // with a row more on either side, which is zero beyond the volume
    const Index n = std::min(rows, H - first), plane = (n + 2) * W;
    auto band = BasicTensor<T>::uninitialised({1, C, D, n + 2, W});
    const bool above = first > 0, below = first + n < H;
    for_each_index(C * D, [&](Index k) {
      T* const to = band.data() + k * plane;
      if (above)
        std::copy_n(before.data() + (k * (rows + 2) + rows) * W, 2 * W, to);
      else
        std::fill_n(to, W, T(0));
      if (!below) std::fill_n(to + (n + 1) * W, W, T(0));
    });
    // those that the band above had are there: its own last row and the one beyond
    const Index fresh = above ? first + 1 : first;
    sweep.rows(fresh, first + n + (below ? 1 : 0), band.data() + (fresh - first + 1) * W, plane);
    before = band;
    ChannelMoments of_band;
    conv3d_rows(Normalised<T>(BasicVar<T>(std::move(band))), weight, {1, 0, 1}, out, first,
                &of_band);
    if (n == H) return first_.finished(BasicVar<T>(std::move(out)), of_band);
    for (std::size_t c = 0; c < moments.size(); ++c) moments[c].merge(of_band[c]);
  }
  return first_.finished(BasicVar<T>(std::move(out)), moments);
}

template <class T>
BasicVar<T> CostNet<T>::after_first(Normalised<T> first, const BasicVar<T>& features,
                                    const std::function<void()>& poll) const {
  const auto polled = [&poll](Normalised<T> x) {
    if (poll) poll();
    return x;
  };
  const Index D = first.dim(2), H = first.dim(3), W = first.dim(4);
  std::vector<Normalised<T>> skips;
  skips.push_back(polled(std::move(first)));
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

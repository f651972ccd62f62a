// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/sigma_net.h"

#include "satsurf/core/box_filters.h"
#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"
#include "satsurf/nn/squeezed.h"
#include "satsurf/ops/concat.h"
#include "satsurf/ops/elementwise.h"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

namespace satsurf::nn {
namespace {

constexpr Index kGrain = 1 << 14;

/// A map by another's cells.
template <class Of>
Tensor mapped(const Tensor& map, const Of& of) {
  Tensor out = Tensor::uninitialised(map.shape());
  for_range(map.count(), kGrain, [&](Index begin, Index end) {
    for (Index i = begin; i < end; ++i) out[i] = of(i);
  });
  return out;
}

/// Where a map of a surface with holes is known: the mean of a square, its least and its largest value.
class Squares {
 public:
  Squares(const Tensor& known, Index radius)
      : known_(known), radius_(radius), share_(box_mean(known, radius)) {}

  Tensor mean(const Tensor& map) const {
    const Tensor sums =
        box_mean(mapped(map, [&](Index i) { return known_[i] > 0 ? map[i] : 0.f; }), radius_);
    return mapped(map, [&](Index i) { return known_[i] > 0 ? sums[i] / share_[i] : 0.f; });
  }
  Tensor most(const Tensor& map) const { return extreme(map, 1); }
  Tensor least(const Tensor& map) const { return extreme(map, -1); }

 private:
  Tensor extreme(const Tensor& map, float sign) const {
    const Tensor most = box_max(
        mapped(map, [&](Index i) { return known_[i] > 0 ? sign * map[i] : -INFINITY; }), radius_);
    return mapped(map, [&](Index i) { return known_[i] > 0 ? sign * most[i] : 0.f; });
  }

  const Tensor& known_;
  Index radius_;
  Tensor share_;
};

}  // namespace

Tensor sigma_channels(const FoundSurface& found) {
  Dims dim("sigma_channels");
  dim.match("heights", found.heights, "H W")
      .match("log_scale", found.log_scale, "H W")
      .match("sure", found.sure, "H W")
      .match("most", found.most, "H W")
      .match("spread", found.spread, "H W");
  const Index P = found.heights.count();
  const Tensor known =
      mapped(found.heights, [&](Index i) { return std::isfinite(found.heights[i]) ? 1.f : 0.f; });
  Tensor out({1, kSigmaChannels, dim["H"], dim["W"]});
  Index channel = 0;
  const auto add = [&](const auto& of) {
    float* to = out.data() + channel++ * P;
    for_range(P, kGrain, [&](Index begin, Index end) {
      for (Index i = begin; i < end; ++i)
        if (known[i] > 0) to[i] = of(i);
    });
  };
  const auto add_map = [&](const Tensor& map) { add([&](Index i) { return map[i]; }); };
  const auto add_rise = [&](const Tensor& from, const Tensor& to) {
    add([&](Index i) {
      return static_cast<float>(
          squeezed(static_cast<double>(to[i]) - static_cast<double>(from[i])));
    });
  };
  // Agreement to a fiftieth of an interval is agreement.
  const Tensor spread =
      mapped(found.spread, [&](Index i) { return std::log(found.spread[i] + 0.02f); });
  for (const Tensor* map : {&found.log_scale, &found.sure, &spread, &found.most}) add_map(*map);
  for (const Index radius : kSigmaRadii) {
    const Squares around(known, radius);
    for (const Tensor* map : {&found.log_scale, &found.sure, &spread}) add_map(around.mean(*map));
    add_map(around.most(found.log_scale));
    add_map(around.least(found.log_scale));
    add_rise(found.heights, around.most(found.heights));
    add_rise(around.least(found.heights), found.heights);
    add_rise(around.mean(found.heights), found.heights);
  }
  return out;
}

template <class T>
SigmaNet<T>::SigmaNet(ParameterSet<T>& p, const std::string& name, Index hidden)
    : first_(p, name + "first", kSigmaChannels, hidden, 1),
      second_(p, name + "second", hidden, hidden, 1),
      head_(p, name + "head", hidden, 1, 1) {}

template <class T>
BasicVar<T> SigmaNet<T>::operator()(const BasicTensor<T>& channels) const {
  Dims dim("sigma_net");
  dim.match("channels", channels, "1 C H W");
  const Index H = dim["H"], W = dim["W"];
  // What is between has more channels than there is room for, if the surface is large.
  constexpr Index kCells = 1 << 13;
  const Index rows = std::max<Index>(1, kCells / W);
  std::vector<BasicVar<T>> strips;
  const BasicVar<T> all(channels);
  for (Index y = 0; y < H; y += rows) {
    const BasicVar<T> strip = slice(all, 2, y, std::min(H, y + rows));
    strips.push_back(head_(relu(second_(relu(first_(strip))))));
  }
  return reshape(strips.size() == 1 ? strips.front() : concat(strips, 2), {H, W});
}

template class SigmaNet<float>;
template class SigmaNet<double>;

}  // namespace satsurf::nn

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/sigma_net.h"

#include "satsurf/core/box_filters.h"
#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"
#include "satsurf/nn/squeezed.h"
#include "satsurf/ops/concat.h"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

namespace satsurf::nn {
namespace {

constexpr Index kGrain = 1 << 14;

}  // namespace

Tensor sigma_channels(const FoundSurface& found) {
  Dims dim("sigma_channels");
  dim.match("heights", found.heights, "H W")
      .match("log_scale", found.log_scale, "H W")
      .match("sure", found.sure, "H W")
      .match("most", found.most, "H W")
      .match("spread", found.spread, "H W");
  const Index P = found.heights.count();
  const auto is_known = [&](Index i) { return std::isfinite(found.heights[i]); };
  // A map with a number in the holes that changes no sum, or no largest value.
  const auto filled = [&](float hole, const auto& of) {
    Tensor map({dim["H"], dim["W"]}, hole);
    for_range(P, kGrain, [&](Index begin, Index end) {
      for (Index i = begin; i < end; ++i)
        if (is_known(i)) map[i] = of(i);
    });
    return map;
  };
  const auto same = [](const Tensor& map) { return [z = map.data()](Index i) { return z[i]; }; };
  const auto negative = [](const Tensor& map) {
    return [z = map.data()](Index i) { return -z[i]; };
  };
  // Agreement to a fiftieth of an interval is agreement.
  const auto log_spread = [&](Index i) { return std::log(found.spread[i] + 0.02f); };
  const Tensor known = filled(0, [](Index) { return 1.f; }),
               scale = filled(0, same(found.log_scale)), sure = filled(0, same(found.sure)),
               spread = filled(0, log_spread), height = filled(0, same(found.heights));
  const Tensor up = filled(-INFINITY, same(found.heights)),
               down = filled(-INFINITY, negative(found.heights)),
               unsure = filled(-INFINITY, same(found.log_scale)),
               surest = filled(-INFINITY, negative(found.log_scale));
  Tensor out({1, kSigmaChannels, dim["H"], dim["W"]});
  Index channel = 0;
  const auto add = [&](const auto& of) {
    float* to = out.data() + channel++ * P;
    for_range(P, kGrain, [&](Index begin, Index end) {
      for (Index i = begin; i < end; ++i)
        if (is_known(i)) to[i] = of(i);
    });
  };
  const auto add_rise = [&](const auto& from, const auto& to) {
    add([&](Index i) { return squeezed(to(i) - from(i)); });
  };
  for (const Tensor* map : {&scale, &sure, &spread, &found.most}) add(same(*map));
  for (const Index radius : kSigmaRadii) {
    const Tensor share = box_mean(known, radius);
    const auto mean = [&](const Tensor& sums) {
      return [z = sums.data(), n = share.data()](Index i) { return z[i] / n[i]; };
    };
    for (const Tensor* map : {&scale, &sure, &spread}) add(mean(box_mean(*map, radius)));
    add(same(box_max(unsure, radius)));
    add(negative(box_max(surest, radius)));
    add_rise(same(height), same(box_max(up, radius)));
    add_rise(negative(box_max(down, radius)), same(height));
    add_rise(mean(box_mean(height, radius)), same(height));
  }
  return out;
}

template <class T>
SigmaNet<T>::SigmaNet(ParameterSet<T>& p, const std::string& name, Index hidden)
    : first_(p, name + "first", kSigmaChannels, hidden, 1),
      second_(p, name + "second", hidden, hidden, 1),
      head_(p, name + "head", hidden, 1, 1) {}

template <class T>
BasicVar<T> SigmaNet<T>::operator()(const Tensor& channels) const {
  Dims dim("sigma_net");
  dim.match("channels", channels, "1 C H W");
  const Index H = dim["H"], W = dim["W"];
  // What is between has more channels than there is room for, if the surface is large.
  constexpr Index kCells = 1 << 13;
  const Index rows = std::max<Index>(1, kCells / W);
  std::vector<BasicVar<T>> strips;
  const Var all(channels);
  for (Index y = 0; y < H; y += rows) {
    const BasicVar<T> strip(slice(all, 2, y, std::min(H, y + rows)).value().template cast<T>());
    strips.push_back(head_(then_relu(second_(then_relu(first_(strip))))));
  }
  return reshape(strips.size() == 1 ? strips.front() : concat(strips, 2), {H, W});
}

template class SigmaNet<float>;
template class SigmaNet<double>;

}  // namespace satsurf::nn

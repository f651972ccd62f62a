// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/features.h"

#include "satsurf/core/parallel.h"
#include "satsurf/ops/concat.h"

#include <algorithm>
#include <span>
#include <utility>
#include <vector>

namespace satsurf::nn {
namespace {

/// One tensor [N ...] of one plane stack of every view.
template <class T>
BasicTensor<T> stacked(const std::vector<PosedImage>& views, const Tensor PosedImage::*member) {
  const Shape& one = (views[0].*member).shape();
  std::vector<Index> extents{static_cast<Index>(views.size())};
  extents.insert(extents.end(), one.extents().begin(), one.extents().end());
  auto out = BasicTensor<T>::uninitialised(Shape(std::span<const Index>(extents)));
  constexpr Index kGrain = 1 << 16;
  const Index count = one.count();
  for (std::size_t n = 0; n < views.size(); ++n) {
    const float* const from = (views[n].*member).data();
    T* const to = out.data() + static_cast<Index>(n) * count;
    for_range(count, kGrain,
              [&](Index begin, Index end) { std::copy(from + begin, from + end, to + begin); });
  }
  return out;
}

}  // namespace

template <class T>
FeatureExtractor<T>::FeatureExtractor(ParameterSet<T>& p, const ModelConfig& config)
    : fuses_(config.fusion != Fusion::none),
      local_contrast_(config.local_contrast),
      fpn_(p, {.base = config.base,
               .levels = config.feature_levels,
               .local_contrast = config.local_contrast}) {
  if (config.mono != MonoBranch::none) mono_.emplace(p, "mono", config.mono_net);
}

template <class T>
Index FeatureExtractor<T>::mono_channels(std::size_t stage) const {
  if (!mono_ || stage == 0) return 0;
  return stage == 1 ? mono_->half_channels() : mono_->full_channels();
}

template <class T>
BasicTensor<T> stacked_images(const NetworkInput& scene) {
  return stacked<T>(scene.sources, &PosedImage::rgb);
}

template <class T>
FeatureMaps<T> FeatureExtractor<T>::operator()(const NetworkInput& scene,
                                               const std::function<void()>& poll,
                                               Wanted wanted) const {
  using Maps = std::vector<BasicVar<T>>;  // of one view each
  std::array<Maps, 3> fpn, mono;
  Maps mono_height;
  for (const PosedImage& view : scene.sources) {
    if (poll) poll();
    const BasicVar<T> image(standardised<T>(view));
    const auto levels = fpn_(
        local_contrast_ ? concat<T>({image, BasicVar<T>(locally_normalised<T>(view))}, 1) : image);
    for (std::size_t s = 0; s < 3; ++s) fpn[s].push_back(levels[s]);
    if (!mono_) continue;
    if (poll) poll();
    const NoGrad no_grad;
    const MonoOutput<T> alone = (*mono_)(image, learns(wanted));
    if (!alone.height.empty()) mono_height.push_back(alone.height);
    if (!fuses_) continue;
    mono[1].push_back(alone.features_half);
    mono[2].push_back(alone.features_full);
  }
  const auto joined = [](Maps& maps) {
    return maps.empty() ? BasicVar<T>() : concat(std::exchange(maps, {}), 0);
  };
  FeatureMaps<T> out;
  if (!mono_height.empty()) out.mono_height = joined(mono_height).value();
  for (std::size_t s = 0; s < 3; ++s) {
    out.fpn[s] = joined(fpn[s]);
    out.mono[s] = joined(mono[s]);
  }
  out.validity = stacked<T>(scene.sources, &PosedImage::valid);
  return out;
}

template Tensor stacked_images(const NetworkInput&);
template BasicTensor<double> stacked_images(const NetworkInput&);
template class FeatureExtractor<float>;
template class FeatureExtractor<double>;

}  // namespace satsurf::nn

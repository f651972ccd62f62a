// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/fusion.h"

#include "satsurf/core/dims.h"
#include "satsurf/ops/blend.h"
#include "satsurf/ops/concat.h"
#include "satsurf/ops/elementwise.h"
#include "satsurf/ops/resize.h"

#include <cmath>
#include <vector>

namespace satsurf::nn {
namespace {

constexpr double kGate = -4;  // W = 0.02 where the confidence is tau

template <class T>
void make_identity(Conv2d<T>& conv) {
  BasicTensor<T>& w = conv.weight.mutable_value();
  w.fill(T(0));
  for (Index c = 0; c < w.dim(0); ++c) w[c * w.dim(1) + c] = T(1);
}

}  // namespace

template <class T>
FeatureFusion<T>::FeatureFusion(ParameterSet<T>& p, const std::string& name,
                                const ModelConfig& config, Index channels, Index mono_channels)
    : naive_(config.fusion == Fusion::naive),
      additive_(config.fusion_start == FusionStart::additive),
      lambda_(config.fusion_lambda),
      tau_(config.fusion_tau) {
  if (naive_) {
    if (mono_channels > 0)
      joined_.emplace(p, name + ".joined", channels + mono_channels, channels, 1);
    return;
  }
  const bool as_published = config.fusion_start == FusionStart::paper;
  value_features_.emplace(p, name + ".value_features", channels, channels, 1);
  if (!as_published) make_identity(*value_features_);
  if (mono_channels == 0) return;
  query_.emplace(p, name + ".query", channels, channels, 1);
  key_features_.emplace(p, name + ".key_features", channels, channels, 1);
  key_mono_.emplace(p, name + ".key_mono", mono_channels, channels, 1);
  value_mono_.emplace(p, name + ".value_mono", mono_channels, channels, 1);
  value_mono_->weight.mutable_value().fill(T(0));
  if (as_published) return;
  query_->weight.mutable_value().fill(T(0));
  if (additive_) return;
  offset_ = p.create(name + ".offset", {1}, Init::constant(kGate), false);
}

template <class T>
BasicVar<T> FeatureFusion<T>::operator()(const BasicVar<T>& features, const BasicVar<T>& mono,
                                         const BasicTensor<T>& confidence) const {
  Dims dim("fusion");
  dim.match("features", features, "N C h w").match("confidence", confidence, "N h w");
  if (!mono.empty()) dim.match("mono", mono, "N M h w");
  if (naive_) return joined_ ? (*joined_)(concat<T>({features, mono}, 1)) : features;
  const BasicVar<T> own = (*value_features_)(features);
  if (!query_) return own;

  const Index N = dim["N"], h = dim["h"], w = dim["w"];
  const BasicVar<T> query = (*query_)(features);
  const BasicVar<T> product =
      channel_dot(query, sub((*key_mono_)(mono), (*key_features_)(features)));
  // a 1 x 1 convolution scales by 1 / sqrt(d) and adds the offset
  const BasicVar<T> scale(
      BasicTensor<T>({1, 1, 1, 1}, static_cast<T>(1 / std::sqrt(static_cast<double>(dim["C"])))));
  const BasicVar<T> scaled =
      reshape(conv2d(reshape(product, Shape{N, 1, h, w}), scale, offset_), Shape{N, h, w});
  auto bias = BasicTensor<T>::uninitialised(confidence.shape());  // -2 b
  for (Index i = 0; i < bias.count(); ++i)
    bias[i] = static_cast<T>(-2 * lambda_ * (static_cast<double>(confidence[i]) - tau_));
  const BasicVar<T> weight = sigmoid(scaled + BasicVar<T>(bias));
  const BasicVar<T> other = (*value_mono_)(mono);
  return add_weighted(own, weight, additive_ ? other : sub(other, own));
}

template <class T>
BasicVar<T> FeatureFusion<T>::fuse_views(const BasicVar<T>& features, const BasicVar<T>& mono,
                                         const BasicTensor<T>& confidence) const {
  const Index N = features.dim(0), h = features.dim(2), w = features.dim(3);
  const auto of_view = [](const BasicVar<T>& x, Index i) {
    return x.empty() ? x : slice(x, 0, i, i + 1);
  };
  BasicTensor<T> resized;
  {
    const NoGrad no_grad;
    resized = resize_bilinear(BasicVar<T>(confidence), h, w).value();
  }
  std::vector<BasicVar<T>> fused;
  for (Index i = 0; i < N; ++i)
    fused.push_back(
        (*this)(of_view(features, i), of_view(mono, i), resized.slice0(i).reshaped({1, h, w})));
  return concat(fused, 0);
}

template class FeatureFusion<float>;
template class FeatureFusion<double>;

}  // namespace satsurf::nn

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/guidance.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"
#include "satsurf/ops/concat.h"
#include "satsurf/ops/elementwise.h"
#include "satsurf/ops/resize.h"
#include "satsurf/ops/robust.h"
#include "satsurf/splat/view.h"

#include <algorithm>
#include <cmath>

namespace satsurf::nn {
namespace {

constexpr Index kWidth = 32;
constexpr double kFlat = 0.1;    // m: flat ground has a MAD of centimetres, which are noise
constexpr double kLargest = 10;  // of a residual
constexpr double kCovered = 0.5;
constexpr double kAllFour = 0.999;  // of the pixels a bilinear sample reads

/// 1 where `share` is at least half, else 0.
template <class T>
BasicTensor<T> mostly(const BasicTensor<T>& share) {
  auto out = BasicTensor<T>::uninitialised(share.shape());
  for (Index i = 0; i < out.count(); ++i)
    out[i] = static_cast<double>(share[i]) >= kCovered ? T(1) : T(0);
  return out;
}

template <class T>
BasicTensor<T> resized(const BasicTensor<T>& maps, Index h, Index w) {
  return resize_bilinear(BasicVar<T>(maps), h, w).value();
}

/// Activation of a value that nobody has to keep.
template <class T>
Normalised<T> rectified(BasicVar<T> x) {
  return {std::move(x), {}, Activation::relu};
}

/// The surface of a stage from each view: its colours or its heights.
template <class T>
RenderedMaps<T> rendered_into(const std::vector<PosedImage>& views, const StageOutput<T>& stage,
                              bool colours) {
  std::vector<BasicVar<T>> values, alphas;
  for (const PosedImage& view : views) {
    const auto render = splat::render_view(stage.surfels, view.pixel_from_local, view.rgb.dim(1),
                                           view.rgb.dim(2), stage.stride);
    const Index h = render.alpha.dim(0), w = render.alpha.dim(1);
    values.push_back(colours ? reshape(render.colour, Shape{1, 3, h, w})
                             : reshape(render.height, Shape{1, h, w}));
    alphas.push_back(reshape(render.alpha, Shape{1, h, w}));
  }
  return {concat(values, 0).value(), concat(alphas, 0).value()};
}

}  // namespace

template <class T>
BasicTensor<T> guidance_residual(const GuidedMaps<T>& stage, const RenderedMaps<T>& rendered,
                                 GuidanceNorm norm) {
  const NoGrad no_grad;
  Dims dim("guidance_residual");
  dim.match("height", stage.height, "N h w")
      .match("confidence", stage.confidence, "N h w")
      .match("validity", stage.validity, "N h w");
  dim.match("rendered", rendered.values, "N H W").match("alpha", rendered.alpha, "N H W");
  const Index N = dim["N"], h = dim["h"], w = dim["w"], P = h * w;

  BasicTensor<T> height = stage.height, rendered_height = rendered.values;
  const BasicTensor<T> valid = mostly(stage.validity), covered = mostly(rendered.alpha);
  if (norm == GuidanceNorm::robust) {
    height = robust_normalised(height, valid, static_cast<T>(kFlat));
    rendered_height = robust_normalised(rendered_height, covered, static_cast<T>(kFlat));
  }
  rendered_height = resized(rendered_height, h, w);
  // Near the rim of what was rendered bilinear samples mix in zeros: all four must be covered.
  const BasicTensor<T> coverage = resized(covered, h, w);

  const double unit = norm == GuidanceNorm::robust ? 1 : 1 / stage.interval;
  auto out = BasicTensor<T>::uninitialised({N, 3, h, w});
  for_each_index(N * h, [&](Index row) {
    const Index n = row / h;
    for (Index i = row % h * w; i < (row % h + 1) * w; ++i) {
      const Index at = n * P + i;
      const bool known = valid[at] > 0 && static_cast<double>(coverage[at]) > kAllFour;
      const double d = known ? static_cast<double>(height[at] - rendered_height[at]) * unit : 0;
      const double clamped = std::clamp(d, -kLargest, kLargest);
      T* to = out.data() + n * 3 * P + i;
      to[0] = static_cast<T>(clamped);
      to[P] = static_cast<T>(std::abs(clamped));
      to[2 * P] = stage.confidence[at];
    }
  });
  return out;
}

template <class T>
BasicTensor<T> photometric_residual(const GuidedMaps<T>& stage, const RenderedMaps<T>& rendered) {
  const NoGrad no_grad;
  Dims dim("photometric_residual");
  dim.match("image", stage.image, "N 3 h w").match("validity", stage.validity, "N h w");
  dim.match("rendered", rendered.values, "N 3 H W").match("alpha", rendered.alpha, "N H W");
  const Index h = dim["h"], w = dim["w"], P = h * w;
  const BasicTensor<T> valid = mostly(stage.validity),
                       coverage = resized(mostly(rendered.alpha), h, w);
  const BasicTensor<T> rendered_image = resized(rendered.values, h, w);
  auto out = BasicTensor<T>::uninitialised(stage.image.shape());
  for_range(out.count(), 1 << 14, [&](Index begin, Index end) {
    for (Index i = begin; i < end; ++i) {
      const Index at = i / (3 * P) * P + i % P;
      const bool known = valid[at] > 0 && static_cast<double>(coverage[at]) > kAllFour;
      out[i] = known ? stage.image[i] - rendered_image[i] : T(0);
    }
  });
  return out;
}

template <class T>
CrossStageGuidance<T>::CrossStageGuidance(ParameterSet<T>& p, const std::string& name,
                                          const ModelConfig& config, Index channels)
    : photometric_(config.guidance == Guidance::photometric),
      norm_(config.guidance_norm),
      gate1_(p, name + ".gate1", channels, kWidth, 3),
      gate2_(p, name + ".gate2", kWidth, channels, 3),
      residual1_(p, name + ".residual1", 3, kWidth, 1),
      residual2_(p, name + ".residual2", kWidth, channels, 1) {
  residual2_.weight.mutable_value().fill(T(0));
}

template <class T>
BasicVar<T> CrossStageGuidance<T>::residual(const GuidedMaps<T>& stage,
                                            const StageOutput<T>& previous,
                                            const std::vector<PosedImage>& views) const {
  const NoGrad no_grad;
  const RenderedMaps<T> rendered = rendered_into(views, previous, photometric_);
  return BasicVar<T>(photometric_ ? photometric_residual(stage, rendered)
                                  : guidance_residual(stage, rendered, norm_));
}

template <class T>
BasicVar<T> CrossStageGuidance<T>::operator()(const BasicVar<T>& x,
                                              const BasicVar<T>& residual) const {
  const BasicVar<T> gate = sigmoid(gate2_(rectified(gate1_(x))));
  return x + gate * residual2_(rectified(residual1_(residual)));
}

template Tensor guidance_residual(const GuidedMaps<float>&, const RenderedMaps<float>&,
                                  GuidanceNorm);
template BasicTensor<double> guidance_residual(const GuidedMaps<double>&,
                                               const RenderedMaps<double>&, GuidanceNorm);
template Tensor photometric_residual(const GuidedMaps<float>&, const RenderedMaps<float>&);
template BasicTensor<double> photometric_residual(const GuidedMaps<double>&,
                                                  const RenderedMaps<double>&);
template class CrossStageGuidance<float>;
template class CrossStageGuidance<double>;

}  // namespace satsurf::nn

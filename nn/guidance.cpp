// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/guidance.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"
#include "satsurf/ops/elementwise.h"
#include "satsurf/ops/resize.h"
#include "satsurf/ops/robust.h"

#include <algorithm>
#include <cmath>

namespace satsurf::nn {
namespace {

constexpr Index kWidth = 32;
constexpr double kFlat = 0.1;    // m: flat ground has a MAD of centimetres, which are noise
constexpr double kLargest = 10;  // of a residual
constexpr double kCovered = 0.5;
constexpr double kWhole = 0.999;  // of the pixels a bilinear sample reads

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

}  // namespace

template <class T>
BasicTensor<T> guidance_residual(const BasicTensor<T>& height, const BasicTensor<T>& confidence,
                                 const BasicTensor<T>& valid, const BasicTensor<T>& rendered,
                                 const BasicTensor<T>& alpha, GuidanceNorm norm, double interval) {
  const NoGrad no_grad;
  Dims dim("guidance_residual");
  dim.match("height", height, "N h w")
      .match("confidence", confidence, "N h w")
      .match("valid", valid, "N h w");
  dim.match("rendered", rendered, "N H W").match("alpha", alpha, "N H W");
  const Index N = dim["N"], h = dim["h"], w = dim["w"], P = h * w;

  BasicTensor<T> ours = height, theirs = rendered;
  const BasicTensor<T> seen = mostly(valid), covered = mostly(alpha);
  if (norm == GuidanceNorm::robust) {
    ours = robust_normalised(height, seen, static_cast<T>(kFlat));
    theirs = robust_normalised(rendered, covered, static_cast<T>(kFlat));
  }
  theirs = resized(theirs, h, w);
  // Near the rim of what was rendered bilinear samples mix in zeros: all four must be covered.
  const BasicTensor<T> whole = resized(covered, h, w);

  const double unit = norm == GuidanceNorm::robust ? 1 : 1 / interval;
  auto out = BasicTensor<T>::uninitialised({N, 3, h, w});
  for_each_index(N * h, [&](Index row) {
    const Index n = row / h;
    for (Index i = row % h * w; i < (row % h + 1) * w; ++i) {
      const Index at = n * P + i;
      const bool known = seen[at] > 0 && static_cast<double>(whole[at]) > kWhole;
      const double d = known ? static_cast<double>(ours[at] - theirs[at]) * unit : 0;
      const double clamped = std::clamp(d, -kLargest, kLargest);
      T* to = out.data() + n * 3 * P + i;
      to[0] = static_cast<T>(clamped);
      to[P] = static_cast<T>(std::abs(clamped));
      to[2 * P] = confidence[at];
    }
  });
  return out;
}

template <class T>
BasicTensor<T> photometric_residual(const BasicTensor<T>& image, const BasicTensor<T>& valid,
                                    const BasicTensor<T>& rendered, const BasicTensor<T>& alpha) {
  const NoGrad no_grad;
  Dims dim("photometric_residual");
  dim.match("image", image, "N 3 h w").match("valid", valid, "N h w");
  dim.match("rendered", rendered, "N 3 H W").match("alpha", alpha, "N H W");
  const Index h = dim["h"], w = dim["w"], P = h * w;
  const BasicTensor<T> seen = mostly(valid), covered = resized(mostly(alpha), h, w);
  const BasicTensor<T> theirs = resized(rendered, h, w);
  auto out = BasicTensor<T>::uninitialised(image.shape());
  for_range(image.count(), 1 << 14, [&](Index begin, Index end) {
    for (Index i = begin; i < end; ++i) {
      const Index at = i / (3 * P) * P + i % P;
      const bool known = seen[at] > 0 && static_cast<double>(covered[at]) > kWhole;
      out[i] = known ? image[i] - theirs[i] : T(0);
    }
  });
  return out;
}

template <class T>
Guidance<T>::Guidance(ParameterSet<T>& p, const std::string& name, Index channels)
    : gate1_(p, name + ".gate1", channels, kWidth, 3),
      gate2_(p, name + ".gate2", kWidth, channels, 3),
      residual1_(p, name + ".residual1", 3, kWidth, 1),
      residual2_(p, name + ".residual2", kWidth, channels, 1) {
  residual2_.weight.mutable_value().fill(T(0));
}

template <class T>
BasicVar<T> Guidance<T>::operator()(const BasicVar<T>& x, const BasicVar<T>& residual) const {
  const BasicVar<T> gate = sigmoid(gate2_(rectified(gate1_(x))));
  return x + gate * residual2_(rectified(residual1_(residual)));
}

template BasicTensor<float> guidance_residual(const Tensor&, const Tensor&, const Tensor&,
                                              const Tensor&, const Tensor&, GuidanceNorm, double);
template BasicTensor<double> guidance_residual(const BasicTensor<double>&,
                                               const BasicTensor<double>&,
                                               const BasicTensor<double>&,
                                               const BasicTensor<double>&,
                                               const BasicTensor<double>&, GuidanceNorm, double);
template BasicTensor<float> photometric_residual(const Tensor&, const Tensor&, const Tensor&,
                                                 const Tensor&);
template BasicTensor<double> photometric_residual(const BasicTensor<double>&,
                                                  const BasicTensor<double>&,
                                                  const BasicTensor<double>&,
                                                  const BasicTensor<double>&);
template class Guidance<float>;
template class Guidance<double>;

}  // namespace satsurf::nn

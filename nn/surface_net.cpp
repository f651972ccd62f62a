// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/surface_net.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"
#include "satsurf/core/symmetry.h"
#include "satsurf/nn/parameter_limit.h"
#include "satsurf/nn/squeezed.h"
#include "satsurf/ops/candidates.h"
#include "satsurf/ops/concat.h"
#include "satsurf/ops/elementwise.h"
#include "satsurf/ops/resize.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <string>
#include <utility>

namespace satsurf::nn {
namespace {

/// Channels at strides 1 to 16, in units of the base.
constexpr std::array<Index, 5> kWidths{1, 2, 4, 6, 8};
/// 3 x 3 convolutions behind the halvings to strides 2 to 16.
constexpr std::array<Index, 4> kSame{1, 1, 1, 2};
constexpr Index kMultiple = 16;
/// The symmetries that are looked at (see `turned`): none, and mirrored both ways. With the two that
/// are mirrored one way the error is 0.3 % less, and the work twice as much.
constexpr std::array<Index, 2> kLooks{0, 3};
/// What the mean of their logits is multiplied with: a mean of answers is less sure than they are, and
/// a mean of candidates lies between them.
constexpr float kSharper = 1.25F;

/// What the first convolution reads: of every candidate its height above the ground and above the
/// mode, then the planes, then where there are surfels.
constexpr Index kChannels = 2 * kSurfaceCandidates + kSurfacePlanes + 1;

/// Of the candidates' weights the largest, and how far those that have some are from the height.
/// P  cells of a plane
template <class T>
void add_choice(const T* logits, const float* candidates, Index P, const SurfaceInput& input,
                Index cell, FoundSurface& to) {
  const auto height = static_cast<double>(to.heights[cell]) * input.interval;
  double top = -INFINITY, sum = 0, square = 0;
  for (Index k = 0; k < kSurfaceCandidates; ++k)
    if (std::isfinite(candidates[k * P])) top = std::max(top, static_cast<double>(logits[k * P]));
  for (Index k = 0; k < kSurfaceCandidates; ++k) {
    const double d = static_cast<double>(candidates[k * P]) - height;
    if (!std::isfinite(d)) continue;
    const double w = std::exp(static_cast<double>(logits[k * P]) - top);
    sum += w, square += w * d * d;
  }
  to.most[cell] = static_cast<float>(1 / sum);
  to.spread[cell] = static_cast<float>(std::sqrt(square / sum) / input.interval);
}

/// What the second network is told of a surface.
template <class T>
FoundSurface found_surface(const SurfaceInput& input, const SurfaceOutput<T>& said,
                           const BasicTensor<T>& heights) {
  const Shape shape = heights.shape();
  const Index P = heights.count();
  FoundSurface out{Tensor(shape), Tensor(shape), Tensor(shape), Tensor(shape), Tensor(shape)};
  const auto plane = [&](SurfacePlane p, Index i) {
    return input.planes[static_cast<Index>(p) * P + i];
  };
  for_range(P, 1 << 12, [&](Index begin, Index end) {
    for (Index i = begin; i < end; ++i) {
      if (!has_candidate(input.candidates, i)) {
        out.heights[i] = std::nanf("");
        continue;
      }
      out.heights[i] = static_cast<float>(static_cast<double>(heights[i]) / input.interval);
      out.log_scale[i] = static_cast<float>(said.log_scale.value()[i]);
      out.sure[i] = plane(SurfacePlane::confidence, i) * plane(SurfacePlane::mode_share, i);
      add_choice(said.logits.value().data() + i, input.candidates.data() + i, P, input, i, out);
    }
  });
  return out;
}

/// The network's answers for the cells of a surface of H x W.
/// all  [1 K+2 h w]
template <class T>
SurfaceOutput<T> output_of(const BasicVar<T>& all, Index H, Index W) {
  const auto cut = [&](Index first, Index last, const Shape& shape) {
    return reshape(slice(slice(slice(all, 1, first, last), 2, 0, H), 3, 0, W), shape);
  };
  constexpr Index K = kSurfaceCandidates;
  return {cut(0, K, {K, H, W}), cut(K, K + 1, {H, W}), cut(K + 1, K + 2, {H, W})};
}

}  // namespace

template <class T>
SurfaceNet<T>::SurfaceNet(ParameterSet<T>& p, const SurfaceConfig& config)
    : stem_(p, "stem", kChannels, config.base, 3),
      head_(p, "head", config.base, kSurfaceCandidates + 2, 3) {
  for (std::size_t l = 0; l < kSame.size(); ++l) {
    const Index in = kWidths[l] * config.base, out = kWidths[l + 1] * config.base;
    const std::string level = "down" + std::to_string(Index{2} << l);
    Down down{Conv2d<T>(p, level + ".halve", in, out, 4, 2), {}};
    for (Index k = 0; k < kSame[l]; ++k)
      down.same.emplace_back(p, level + ".same" + std::to_string(k + 1), out, out, 3);
    down_.push_back(std::move(down));
  }
  for (std::size_t l = kSame.size(); l-- > 0;) {
    const Index in = kWidths[l + 1] * config.base, out = kWidths[l] * config.base;
    const std::string level = "up" + std::to_string(Index{1} << l);
    up_.push_back(Up{Conv2d<T>(p, level + ".reduce", in, out, 1),
                     Conv2d<T>(p, level + ".same", out, out, 3)});
  }
  if (config.sigma_hidden > 0) sigma_.emplace(p, "sigma.", config.sigma_hidden);
}

template <class T>
BasicTensor<T> SurfaceNet<T>::channels(const SurfaceInput& input) {
  Dims dim("surface_net");
  dim.match("candidates", input.candidates, "K H W").match("planes", input.planes, "C H W");
  const Index H = dim["H"], W = dim["W"], P = H * W;
  if (dim["K"] != kSurfaceCandidates || dim["C"] != kSurfacePlanes)
    throw ShapeError("surface_net: candidates have shape " + input.candidates.shape().str() +
                     " and planes " + input.planes.shape().str() + ", expected " +
                     std::to_string(kSurfaceCandidates) + " and " + std::to_string(kSurfacePlanes) +
                     " of them");
  const auto up = [](Index n) { return (n + kMultiple - 1) / kMultiple * kMultiple; };
  const Index h = up(H), w = up(W), p = h * w, K = kSurfaceCandidates;
  constexpr double kGroundUnit = 3;  // m
  BasicTensor<T> out({1, kChannels, h, w});
  // How far the heights of a row are above others, in units; nothing where either is unknown.
  const auto put_above = [&](const float* height, const float* base, double unit, T* to) {
    for (Index j = 0; j < W; ++j)
      if (std::isfinite(height[j]) && std::isfinite(base[j]))
        to[j] = static_cast<T>(squeezed((height[j] - base[j]) / static_cast<float>(unit)));
  };
  for_each_index(H, [&](Index i) {
    const auto candidate = [&](Index k) { return input.candidates.data() + k * P + i * W; };
    const auto channel = [&](Index c) { return out.data() + c * p + i * w; };
    const float *ground = candidate(static_cast<Index>(SurfaceCandidate::ground)),
                *mode = candidate(static_cast<Index>(SurfaceCandidate::mode));
    for (Index k = 0; k < K; ++k) {
      put_above(candidate(k), ground, kGroundUnit, channel(k));
      put_above(candidate(k), mode, input.interval, channel(K + k));
    }
    for (Index c = 0; c < kSurfacePlanes; ++c)
      std::copy_n(input.planes.data() + c * P + i * W, W, channel(2 * K + c));
    std::transform(mode, mode + W, channel(kChannels - 1),
                   [](float z) { return std::isfinite(z) ? T{1} : T{0}; });
  });
  return out;
}

template <class T>
BasicVar<T> SurfaceNet<T>::maps(const BasicTensor<T>& channels) const {
  std::vector<Normalised<T>> skips{then_relu(stem_(BasicVar<T>(channels)))};
  for (const Down& down : down_) {
    Normalised<T> x = then_relu(down.halve(skips.back()));
    for (const Conv2d<T>& same : down.same) x = then_relu(same(x));
    skips.push_back(std::move(x));
  }
  Normalised<T> x = std::move(skips.back());
  for (const Up& up : up_) {
    skips.pop_back();
    const Normalised<T>& skip = skips.back();
    // a 1 x 1 convolution and a resampling commute; this order costs a quarter
    BasicVar<T> wide = resize_bilinear(up.reduce(x), skip.dim(2), skip.dim(3));
    x = then_relu(up.same(add<T>(std::move(wide), skip)));
  }
  return head_(x);
}

template <class T>
BasicVar<T> SurfaceNet<T>::log_scale(const SurfaceInput& input, const SurfaceOutput<T>& said,
                                     const BasicTensor<T>& heights) const {
  const BasicVar<T> before(said.log_scale.value());
  if (!sigma_) return before;
  return before + (*sigma_)(sigma_channels(found_surface(input, said, heights)));
}

template <class T>
SurfaceOutput<T> SurfaceNet<T>::operator()(const SurfaceInput& input) const {
  return output_of(maps(channels(input)), input.planes.dim(1), input.planes.dim(2));
}

SurfaceModel turned(const SurfaceModel& network, Index symmetry) {
  SurfaceModel out = [&] {
    const ParameterLimit limit(network.parameters().count(), "turned");
    return SurfaceModel(network.config(), 0);
  }();
  for (std::size_t i = 0; i < out.parameters().entries().size(); ++i) {
    const Tensor& from = network.parameters().entries()[i].var.value();
    Var to = out.parameters().entries()[i].var;
    const Shape shape = from.shape();
    to.mutable_value() =
        shape.rank() == 4
            ? turned(from.reshaped({shape[0] * shape[1], shape[2], shape[3]}), symmetry)
                  .reshaped(shape)
            : from.clone();
  }
  return out;
}

bool has_candidate(const Tensor& candidates, Index cell) {
  const Index P = candidates.dim(1) * candidates.dim(2);
  for (Index k = 0; k < candidates.dim(0); ++k)
    if (std::isfinite(candidates[k * P + cell])) return true;
  return false;
}

SurfaceOutput<float> mean_of_looks(const SurfaceModel& network, const SurfaceInput& input) {
  const NoGrad no_grad;
  const Tensor channels = SurfaceNet<float>::channels(input);
  Tensor mean;
  for (const Index s : kLooks) {
    const Tensor one = turned(network, s).net().maps(channels).value();
    if (mean.empty()) mean = Tensor(one.shape());
    for_each_index(mean.dim(1), [&](Index c) {
      const Index n = mean.count() / mean.dim(1);
      const float share =
          (c < kSurfaceCandidates ? kSharper : 1) / static_cast<float>(kLooks.size());
      for (Index i = c * n; i < (c + 1) * n; ++i) mean[i] += share * one[i];
    });
  }
  return output_of(Var(std::move(mean)), input.planes.dim(1), input.planes.dim(2));
}

RefinedSurface refined(const SurfaceModel& network, const SurfaceInput& input) {
  const NoGrad no_grad;
  const SurfaceOutput<float> out = mean_of_looks(network, input);
  RefinedSurface surface{
      chosen_height(out.logits, out.residual, input.candidates, kSurfaceReach * input.interval)
          .value(),
      {},
      {}};
  const Index P = surface.heights.count();
  const auto error_of = [&](const Tensor& scales) {
    Tensor error = Tensor::uninitialised(scales.shape());
    for_range(P, 1 << 14, [&](Index begin, Index end) {
      for (Index i = begin; i < end; ++i)
        error[i] =
            has_candidate(input.candidates, i)
                ? static_cast<float>(kSigmaOfScale *
                                     laplace_scale(static_cast<double>(scales[i]), input.interval))
                : std::nanf("");
    });
    return error;
  };
  surface.sigma = error_of(network.net().log_scale(input, out, surface.heights).value());
  surface.doubt = error_of(out.log_scale.value());
  for (Index i = 0; i < P; ++i)
    if (!std::isfinite(surface.doubt[i])) surface.heights[i] = std::nanf("");
  return surface;
}

template class SurfaceNet<float>;
template class SurfaceNet<double>;

}  // namespace satsurf::nn

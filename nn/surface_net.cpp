// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/surface_net.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"
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

/// A height of any size as a number of order 1: differences of noise and those of towers both tell.
double squeezed(double z) { return 0.5 * std::asinh(z); }

/// The planes that the first convolution reads, in their order.
std::vector<Index> planes_of(const SurfaceConfig& config) {
  std::vector<Index> out;
  const auto add = [&](SurfacePlane first, Index count) {
    for (Index k = 0; k < count; ++k) out.push_back(static_cast<Index>(first) + k);
  };
  const Index K = config.candidates();
  add(SurfacePlane::disagreement, K);
  add(SurfacePlane::best_pair, K);
  if (config.sight)
    for (const SurfacePlane plane :
         {SurfacePlane::seen, SurfacePlane::open, SurfacePlane::unhidden})
      add(plane, K);
  add(SurfacePlane::mode_share, kSurfacePlanes - static_cast<Index>(SurfacePlane::mode_share));
  return out;
}

/// What the first convolution reads: of every candidate its height above the ground and above the
/// mode, then the planes, then where there are surfels.
Index channel_count(const SurfaceConfig& config) {
  return 2 * config.candidates() + std::ssize(planes_of(config)) + 1;
}

/// The channels of the network, padded with what a hole looks like: [1 C H W], H and W multiples of
/// kMultiple.
template <class T>
BasicTensor<T> channels_of(const SurfaceConfig& config, const SurfaceInput& input) {
  Dims dim("surface_net");
  dim.match("candidates", input.candidates, "K H W").match("planes", input.planes, "C H W");
  const Index H = dim["H"], W = dim["W"], P = H * W;
  if (dim["K"] != kSurfaceCandidates || dim["C"] != kSurfacePlanes)
    throw ShapeError("surface_net: candidates have shape " + input.candidates.shape().str() +
                     " and planes " + input.planes.shape().str() + ", expected " +
                     std::to_string(kSurfaceCandidates) + " and " + std::to_string(kSurfacePlanes) +
                     " of them");
  const auto up = [](Index n) { return (n + kMultiple - 1) / kMultiple * kMultiple; };
  const Index h = up(H), w = up(W), p = h * w, K = config.candidates();
  constexpr double kGroundUnit = 3;  // m
  const std::vector<Index> planes = planes_of(config);
  const Index channels = channel_count(config);
  BasicTensor<T> out({1, channels, h, w});
  const float* z = input.candidates.data();
  const auto of = [](SurfaceCandidate c) { return static_cast<Index>(c); };
  for_each_index(H, [&](Index i) {
    for (Index j = 0; j < W; ++j) {
      const Index from = i * W + j, to = i * w + j;
      const auto ground = static_cast<double>(z[of(SurfaceCandidate::ground) * P + from]),
                 mode = static_cast<double>(z[of(SurfaceCandidate::mode) * P + from]);
      for (Index k = 0; k < K; ++k) {
        const auto height = static_cast<double>(z[k * P + from]);
        if (!std::isfinite(height)) continue;
        if (std::isfinite(ground))
          out[k * p + to] = static_cast<T>(squeezed((height - ground) / kGroundUnit));
        if (std::isfinite(mode))
          out[(K + k) * p + to] = static_cast<T>(squeezed((height - mode) / input.interval));
      }
      for (std::size_t c = 0; c < planes.size(); ++c)
        out[(2 * K + static_cast<Index>(c)) * p + to] =
            static_cast<T>(input.planes[planes[c] * P + from]);
      out[(channels - 1) * p + to] = std::isfinite(mode) ? T{1} : T{0};
    }
  });
  return out;
}

/// The first K of them.
Tensor first_of(const Tensor& candidates, Index K) {
  if (K == candidates.dim(0)) return candidates;
  auto out = Tensor::uninitialised({K, candidates.dim(1), candidates.dim(2)});
  std::copy_n(candidates.data(), out.count(), out.data());
  return out;
}

}  // namespace

template <class T>
SurfaceNet<T>::SurfaceNet(ParameterSet<T>& p, const SurfaceConfig& config)
    : stem_(p, "stem", channel_count(config), config.base, 3),
      head_(p, "head", config.base, config.candidates() + 2, 3),
      config_(config) {
  if (config.sight)
    direct_ = p.create("direct", {config.candidates() + 2, channel_count(config), 1, 1},
                       Init::constant(0), true);
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
}

template <class T>
SurfaceOutput<T> SurfaceNet<T>::operator()(const SurfaceInput& input) const {
  const BasicVar<T> channels(channels_of<T>(config_, input));
  std::vector<BasicVar<T>> skips{relu(stem_(channels))};
  for (const Down& down : down_) {
    BasicVar<T> x = relu(down.halve(skips.back()));
    for (const Conv2d<T>& same : down.same) x = relu(same(x));
    skips.push_back(std::move(x));
  }
  BasicVar<T> x = std::move(skips.back());
  for (const Up& up : up_) {
    skips.pop_back();
    const BasicVar<T>& skip = skips.back();
    // a 1 x 1 convolution and a resampling commute; this order costs a quarter
    x = relu(up.same(resize_bilinear(up.reduce(x), skip.dim(2), skip.dim(3)) + skip));
  }
  BasicVar<T> all = head_(x);
  // As if the few weights of the linear part had ten times the learning rate: they have as far to go
  // as any and nothing in front of them that could grow instead.
  constexpr T kQuick = 10;
  if (direct_) all = all + affine(conv2d<T>(channels, *direct_, {}, {}), kQuick, T{0});
  const Index H = input.planes.dim(1), W = input.planes.dim(2);
  const auto cut = [&](Index first, Index last, const Shape& shape) {
    return reshape(slice(slice(slice(all, 1, first, last), 2, 0, H), 3, 0, W), shape);
  };
  const Index K = config_.candidates();
  return {first_of(input.candidates, K), cut(0, K, {K, H, W}), cut(K, K + 1, {H, W}),
          cut(K + 1, K + 2, {H, W})};
}

RefinedSurface refined(const SurfaceModel& network, const SurfaceInput& input) {
  const NoGrad no_grad;
  const SurfaceOutput<float> out = network(input);
  RefinedSurface surface{
      chosen_height(out.logits, out.residual, out.candidates, kSurfaceReach * input.interval)
          .value(),
      Tensor::uninitialised(out.log_scale.shape())};
  const Index P = surface.heights.count();
  // A Laplace distribution of mean error b has 68.3 % of its mass within 1.148 b.
  constexpr double kSigma = 1.148;
  for (Index i = 0; i < P; ++i) {
    bool any = false;
    for (Index k = 0; k < out.candidates.dim(0); ++k)
      any = any || std::isfinite(out.candidates[k * P + i]);
    surface.sigma[i] =
        any ? static_cast<float>(
                  kSigma *
                  laplace_scale(static_cast<double>(out.log_scale.value()[i]), input.interval))
            : std::nanf("");
    if (!any) surface.heights[i] = std::nanf("");
  }
  return surface;
}

template class SurfaceNet<float>;
template class SurfaceNet<double>;

}  // namespace satsurf::nn

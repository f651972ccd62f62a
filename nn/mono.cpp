// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/mono.h"

#include "satsurf/core/dims.h"
#include "satsurf/ops/concat.h"
#include "satsurf/ops/resize.h"

#include <array>

namespace satsurf::nn {
namespace {

/// Channels at strides 1 to 32, in units of the base.
constexpr std::array<Index, 6> kWidths{1, 2, 4, 6, 8, 8};
/// 3 x 3 convolutions behind the halvings to strides 2 to 32. At stride 2 they cost most and see
/// least; at stride 32 they cost nothing.
constexpr std::array<Index, 5> kSame{0, 1, 1, 1, 2};

std::string joined(const std::string& name, const std::string& layer) {
  return name.empty() ? layer : name + "." + layer;
}

}  // namespace

template <class T>
MonoNet<T>::MonoNet(ParameterSet<T>& p, const std::string& name, const MonoConfig& config)
    : full_(kWidths[0] * config.base),
      half_(kWidths[1] * config.base),
      stem_(p, joined(name, "stem"), 3, full_, 3, 1, Activation::relu),
      height_(p, joined(name, "height"), full_, 1, 3) {
  for (std::size_t l = 0; l < kSame.size(); ++l) {
    const Index in = kWidths[l] * config.base, out = kWidths[l + 1] * config.base;
    const std::string level = joined(name, "down" + std::to_string(Index{2} << l));
    Down down{ConvNorm2d<T>(p, level + ".halve", in, out, 4, 2, Activation::relu), {}};
    for (Index k = 0; k < kSame[l]; ++k)
      down.same.emplace_back(p, level + ".same" + std::to_string(k + 1), out, out, 3, 1,
                             Activation::relu);
    down_.push_back(std::move(down));
  }
  for (std::size_t l = kSame.size(); l-- > 0;) {
    const Index in = kWidths[l + 1] * config.base, out = kWidths[l] * config.base;
    const std::string level = joined(name, "up" + std::to_string(Index{1} << l));
    up_.push_back(Up{Conv2d<T>(p, level + ".reduce", in, out, 1),
                     ConvNorm2d<T>(p, level + ".same", out, out, 3, 1, Activation::relu)});
  }
}

template <class T>
Normalised<T> MonoNet<T>::raise(const Up& up, const Normalised<T>& coarse,
                                const Normalised<T>& skip) const {
  // a 1 x 1 convolution and a resampling commute; this order costs a quarter
  const BasicVar<T> wide = resize_bilinear(up.reduce(coarse), skip.dim(2), skip.dim(3));
  return up.same(add(Normalised<T>(wide), skip));
}

template <class T>
MonoOutput<T> MonoNet<T>::operator()(const BasicVar<T>& image, bool with_height) const {
  Dims dim("mono");
  dim.match("image", image, "N 3 H W");
  const Index N = dim["N"], H = dim["H"], W = dim["W"];
  if (H % kMonoMultiple != 0 || W % kMonoMultiple != 0)
    throw ShapeError("mono: image has shape " + image.shape().str() +
                     ", expected multiples of 32 rows and columns");
  std::vector<Normalised<T>> skips{stem_(image)};
  for (const Down& down : down_) {
    Normalised<T> x = down.halve(skips.back());
    for (const ConvNorm2d<T>& same : down.same) x = same(x);
    skips.push_back(std::move(x));
  }
  Normalised<T> x = std::move(skips.back());
  MonoOutput<T> out;
  for (const Up& up : up_) {
    skips.pop_back();
    x = raise(up, x, skips.back());
    // both readers of these features then share one evaluation
    if (skips.size() == 2) x = out.features_half = materialise(x);
    if (skips.size() == 1) x = out.features_full = materialise(x);
  }
  if (with_height) out.height = reshape(height_(x), Shape{N, H, W});
  return out;
}

template class MonoNet<float>;
template class MonoNet<double>;

}  // namespace satsurf::nn

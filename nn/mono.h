// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/fields.h"
#include "satsurf/nn/blocks.h"

#include <cstdint>
#include <string>
#include <vector>

namespace satsurf::nn {

/// Every width of the monocular height network.
struct MonoConfig {
  Index base = 12;  ///< channels at full resolution; x2, x4, x6, x8, x8 at strides 2 to 32

  template <class Self, class V>
  static void fields(Self& s, V&& v) {
    v("base", s.base,
      Field{.help = "channels of the monocular network at full resolution", .min = 1, .max = 64});
  }
  friend bool operator==(const MonoConfig&, const MonoConfig&) = default;
};

/// What one image alone tells of the heights in it.
template <class T>
struct MonoOutput {
  BasicVar<T> height;         ///< [N H W] higher is higher; scale and shift are arbitrary
  BasicVar<T> features_half;  ///< [N C2 H/2 W/2] features of the decoder at stride 2
  BasicVar<T> features_full;  ///< [N C3 H W] at stride 1
};

/// Relative heights of single images: an encoder down to stride 32 and a decoder back to stride 1
/// that adds the encoder's features on its way up. A height rests on some 400 x 400 pixels, and
/// through the normalisations on all: on the shadows, roofs and streets around it.
/// With base 12: 833,149 parameters, 0.777 GMAC per 256 x 256 image.
/// Source: Ronneberger et al. 2015 (U-Net), with sums in place of concatenations.
template <class T>
class MonoNet {
 public:
  /// name  begins the parameters' names, `NAME.stem.weight`; empty for none
  MonoNet(ParameterSet<T>& parameters, const std::string& name, const MonoConfig& config);
  /// image        [N 3 H W], each standardised; H and W multiples of `kMonoMultiple`
  /// with_height  false for the features alone: `height` stays empty
  /// throws       ShapeError
  MonoOutput<T> operator()(const BasicVar<T>& image, bool with_height = true) const;

  Index half_channels() const { return half_; }  ///< C2
  Index full_channels() const { return full_; }  ///< C3

 private:
  /// Halves the resolution, then looks around.
  struct Down {
    ConvNorm2d<T> halve;
    std::vector<ConvNorm2d<T>> same;
  };
  /// From one resolution to twice that: fewer channels, then bilinear, plus the encoder's features.
  struct Up {
    Conv2d<T> reduce;
    ConvNorm2d<T> same;
  };
  Normalised<T> raise(const Up& up, const Normalised<T>& coarse, const Normalised<T>& skip) const;

  Index full_, half_;
  ConvNorm2d<T> stem_;
  std::vector<Down> down_;  ///< to strides 2, 4, 8, 16, 32
  std::vector<Up> up_;      ///< to strides 16, 8, 4, 2, 1
  Conv2d<T> height_;
};

/// Sides of the images are multiples of this: the stride of the innermost level.
constexpr Index kMonoMultiple = 32;

/// A monocular network with its own parameters.
template <class T>
class BasicMono {
 public:
  /// Parameters are initialised from `seed`.
  BasicMono(const MonoConfig& config, std::uint64_t seed)
      : config_(config), parameters_(seed), net_(parameters_, "", config) {}

  const MonoConfig& config() const { return config_; }
  ParameterSet<T>& parameters() { return parameters_; }
  const ParameterSet<T>& parameters() const { return parameters_; }
  const MonoNet<T>& net() const { return net_; }
  /// As MonoNet.
  MonoOutput<T> operator()(const BasicVar<T>& image) const { return net_(image); }

 private:
  MonoConfig config_;
  ParameterSet<T> parameters_;
  MonoNet<T> net_;
};
using Mono = BasicMono<float>;

}  // namespace satsurf::nn

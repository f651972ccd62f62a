// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/safetensors.h"
#include "satsurf/core/var.h"
#include "satsurf/ops/conv/conv.h"
#include "satsurf/ops/pool.h"

#include <array>
#include <filesystem>
#include <string>
#include <variant>
#include <vector>

namespace satsurf::nn {

/// The networks LPIPS v0.1 takes its features from.
enum class LpipsBackbone { alex, squeeze, vgg };
/// As papers and the `lpips` package spell them: alex, squeeze, vgg.
const char* lpips_backbone_name(LpipsBackbone backbone);

/// Learned perceptual distance of two images: 0 for equal ones, about 1 for unrelated ones. The
/// distances of the features of a trained network, weighted by channel, layer by layer
/// (`feature_distance`), summed.
/// Source: Zhang et al. 2018, version 0.1 of the weights.
template <class T>
class BasicLpips {
 public:
  /// The network in the `state_dict` of the `lpips` package: `net.slice*`, `lin*.model.1.weight`
  /// and `scaling_layer.*`. The backbone is told by the keys; further keys are passed over.
  /// where   begins the error texts
  /// throws  IoError naming the key that is missing, of another shape or not finite
  BasicLpips(const TensorFile& file, const std::string& where);
  /// That of a safetensors file.
  /// throws  IoError as above, naming the file
  static BasicLpips load(const std::filesystem::path& path);

  LpipsBackbone backbone() const { return backbone_; }
  /// The fewest rows and columns an image may have, px.
  Index smallest_side() const { return smallest_side_; }

  /// The distance, on average over the images.
  /// image      [3 H W] or [B 3 H W] in [0, 1]
  /// reference  image's shape; no gradient
  /// mask       [H W], or [B H W] for images with their own; pixels of 0 read as 0 in both images,
  ///            whatever they hold. Empty for none
  /// returns    a scalar
  /// throws     ShapeError
  /// memory     backward keeps the features of `image`
  BasicVar<T> operator()(const BasicVar<T>& image, const BasicTensor<T>& reference,
                         const BasicTensor<T>& mask = {}) const;

 private:
  struct Convolution {
    BasicVar<T> weight, bias;
    Conv2dOptions options;
    BasicVar<T> operator()(const BasicVar<T>& x) const;  ///< and ReLU
  };
  /// Few channels, then many from two kernel sizes side by side (Iandola et al. 2016, SqueezeNet).
  struct Fire {
    Convolution squeeze, expand1, expand3;
  };
  using Step = std::variant<PoolOptions, Convolution, Fire>;
  /// The steps up to where features are taken, and how much each of their channels counts.
  struct Slice {
    std::vector<Step> steps;
    BasicTensor<T> weight;  ///< [C]
  };

  BasicVar<T> prepared(const BasicVar<T>& image, const BasicTensor<T>& mask) const;
  std::vector<BasicVar<T>> features(BasicVar<T> x) const;

  LpipsBackbone backbone_;
  Index smallest_side_ = 1;
  std::array<T, 3> factor_{}, offset_{};  ///< of red, green and blue before the network
  std::vector<Slice> slices_;
};

using Lpips = BasicLpips<float>;

}  // namespace satsurf::nn

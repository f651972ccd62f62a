// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/fields.h"
#include "satsurf/nn/blocks.h"
#include "satsurf/nn/sigma_net.h"

#include <array>
#include <cstdint>
#include <optional>
#include <vector>

namespace satsurf::nn {

/// The heights that the surface network chooses among, in the order in which it is given them.
enum class SurfaceCandidate : Index {
  mode,    ///< the densest mode of the surfels of a cell
  second,  ///< the densest of those that are no members of it; often none
  low,     ///< a tenth of their weight lies below
  high,    ///< a tenth of it lies above
  around,  ///< the median of the modes nearby, smooth; there is one in holes, too
  ground,  ///< the level of the ground
};
inline constexpr Index kSurfaceCandidates = 6;

/// What else is known of every cell: where each kind of plane begins. Unitless and of order 1, and
/// the same whichever way the grid is turned. Surfels are those that reach the cell, each with its
/// weight times the overlap; without any their planes are 0. Of the images that show a place the first
/// 16 count. `views` to `range` are read at the mode, where there is none at `around`; 0 where no image
/// shows that.
enum class SurfacePlane : Index {
  /// K: mean difference of all pairs of the images that show each candidate, halved; 1 without a pair.
  disagreement = 0,
  best_pair = kSurfaceCandidates,  ///< K: difference of the two that agree best; 1 without a pair
  mode_share = 2 * kSurfaceCandidates,  ///< of the surfels' weight, what the mode's members have
  second_share,                         ///< and the second's
  weight,                               ///< 0.5 log(1 + weight of all surfels per m^2)
  confidence,                           ///< their mean, by weight
  spread,  ///< 0.5 asinh(s / interval), s the standard deviation of their heights, m
  views,   ///< images that show the cell, a quarter of their number
  red,     ///< mean colours there, standardised
  green,
  blue,
  darkest,  ///< of the images there, the mean of its colours
  range,    ///< between the darkest and the brightest of them
  cell,     ///< logarithm of the cell's size in pixels on the ground
  /// K: the images that show each candidate with nothing on the way, a quarter of their number. What
  /// stands on the way is what the modes say, and in holes `around`.
  seen,
  seen_disagreement = seen + kSurfaceCandidates,  ///< K: `disagreement` among those
  /// K: their mean brightness, as `locally_normalised` makes it; 0 of none.
  brightness = seen_disagreement + kSurfaceCandidates,
  count = brightness + kSurfaceCandidates  ///< number of planes
};
inline constexpr Index kSurfacePlanes = static_cast<Index>(SurfacePlane::count);
/// `views` of two images. Where fewer show a cell it teaches nothing, and there is no surface unless two
/// show it at the height that is found.
inline constexpr float kViewsOfTwo = 0.5f;

/// A surface before the network has looked at it.
struct SurfaceInput {
  Tensor candidates;    ///< [K H W] local m, NaN where there is none; K = kSurfaceCandidates
  Tensor planes;        ///< [C H W], see SurfacePlane
  double interval = 1;  ///< height that moves a point by one pixel between two views, m
};

/// Every width of the surface network.
struct SurfaceConfig {
  Index base = 12;  ///< channels at full resolution; x2, x4, x6, x8 at strides 2 to 16
  /// Channels of the network that says what errors to expect of the heights; 0: the first one says it.
  Index sigma_hidden = 0;

  template <class Self, class V>
  static void fields(Self& s, V&& v) {
    v("base", s.base,
      Field{.help = "channels of the surface network at full resolution", .min = 1, .max = 64});
    v("sigma_hidden", s.sigma_hidden,
      Field{.help = "channels of the network that says what errors to expect of its heights; 0: it "
                    "says so itself",
            .min = 0,
            .max = 512});
  }
  friend bool operator==(const SurfaceConfig&, const SurfaceConfig&) = default;
};

/// What the surface network says of every cell; its height is `chosen_height` of the candidates.
template <class T>
struct SurfaceOutput {
  BasicVar<T> logits;     ///< [K H W] of the candidates
  BasicVar<T> residual;   ///< [H W]
  BasicVar<T> log_scale;  ///< [H W] logarithm of the expected error, in intervals
};

/// Sigma in scales b: a Laplace distribution of mean error b has 68.3 % of its mass within that.
inline constexpr double kSigmaOfScale = 1.148;

/// How far a height may be from what the candidates say, in intervals.
inline constexpr double kSurfaceReach = 2;

/// A 2D U-Net on the grid of a surface: of candidates for every cell and what the images say of them
/// it makes one height and says how unsure it is. It looks some 100 cells far. Nothing in it is
/// normalised over the map, so that a cell's height does not depend on the size of the surface. A second
/// network may look at the heights that came of it and say better how large their errors are.
/// Source: after Stucker and Schindler 2022 (ResDepth); here it chooses before it corrects.
template <class T>
class SurfaceNet {
 public:
  SurfaceNet(ParameterSet<T>& parameters, const SurfaceConfig& config);
  /// input   a surface of any size
  /// throws  ShapeError
  SurfaceOutput<T> operator()(const SurfaceInput& input) const;
  /// What the first convolution reads, [1 C h w]: h and w are multiples of the coarsest stride, and
  /// beyond the surface there is what a hole looks like.
  /// throws  ShapeError
  static BasicTensor<T> channels(const SurfaceInput& input);
  /// What comes of it: the logits, the residual and the logarithm of the scale, [1 K+2 h w].
  BasicVar<T> maps(const BasicTensor<T>& channels) const;
  /// The logarithm of the scale once heights are known: what was said of it and what the second network
  /// adds.
  /// said     what the first one says; carries no gradient from here
  /// heights  [H W] m that came of it
  /// returns  [H W]; said's own if there is no second network
  BasicVar<T> log_scale(const SurfaceInput& input, const SurfaceOutput<T>& said,
                        const BasicTensor<T>& heights) const;

 private:
  struct Down {
    Conv2d<T> halve;
    std::vector<Conv2d<T>> same;
  };
  struct Up {
    Conv2d<T> reduce, same;
  };

  Conv2d<T> stem_;
  std::vector<Down> down_;  ///< to strides 2, 4, 8, 16
  std::vector<Up> up_;      ///< to strides 8, 4, 2, 1
  Conv2d<T> head_;
  std::optional<SigmaNet<T>> sigma_;
};

/// A surface network with its own parameters.
template <class T>
class BasicSurfaceModel {
 public:
  /// Parameters are initialised from `seed`.
  BasicSurfaceModel(const SurfaceConfig& config, std::uint64_t seed)
      : config_(config), parameters_(seed), net_(parameters_, config) {}

  const SurfaceConfig& config() const { return config_; }
  ParameterSet<T>& parameters() { return parameters_; }
  const ParameterSet<T>& parameters() const { return parameters_; }
  /// As SurfaceNet.
  SurfaceOutput<T> operator()(const SurfaceInput& input) const { return net_(input); }
  const SurfaceNet<T>& net() const { return net_; }

 private:
  SurfaceConfig config_;
  ParameterSet<T> parameters_;
  SurfaceNet<T> net_;
};
using SurfaceModel = BasicSurfaceModel<float>;

/// The network that sees the mirror image of what `network` sees, and answers with that of its
/// answer: the kernels of its convolutions are turned instead of the maps.
/// symmetry  see `turned`
SurfaceModel turned(const SurfaceModel& network, Index symmetry);

/// A surface as the networks made it.
struct RefinedSurface {
  Tensor heights;  ///< [H W] local m, NaN where there is no candidate
  /// [H W] m, NaN alike: the expected error. On simulated scenes some 71 % of the heights are within it
  /// and 93 % within twice as much.
  Tensor sigma;
  /// [H W] m, NaN alike: the same as the network that found the heights says, 1.148 times the mean error of
  /// the likeliest Laplace distribution. The worst errors count for more in it, so what is no more than a
  /// guess is told by it.
  Tensor doubt;
};
/// Whether a cell has any candidate at all.
/// candidates  [K H W]
bool has_candidate(const Tensor& candidates, Index cell);
/// Applies a network to a surface as it is and to its mirror image east to west and north to south,
/// and takes the mean of what it says: a mirrored place is as likely as the place itself. Its logits
/// count 1.25 times, since the mean is less sure than they are.
/// throws  ShapeError
RefinedSurface refined(const SurfaceModel& network, const SurfaceInput& input);
/// The mean of what the network says with both looks.
SurfaceOutput<float> mean_of_looks(const SurfaceModel& network, const SurfaceInput& input);

}  // namespace satsurf::nn

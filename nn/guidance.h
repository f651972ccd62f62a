// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/blocks.h"
#include "satsurf/nn/config.h"
#include "satsurf/nn/input.h"
#include "satsurf/nn/stage.h"

#include <string>
#include <vector>

namespace satsurf::nn {

/// What a stage knows of its own surface.
template <class T>
struct GuidedMaps {
  BasicTensor<T> image{};       ///< [N 3 h w]
  BasicTensor<T> height{};      ///< [N h w] H_s, m
  BasicTensor<T> confidence{};  ///< [N h w], effective
  BasicTensor<T> validity{};    ///< [N h w] share of the view's data behind each pixel
  double interval = 0;          ///< between the stage's hypotheses, m
};

/// The surface of the stage before, rendered into each source view.
template <class T>
struct RenderedMaps {
  BasicTensor<T> values;  ///< [N h' w'] heights H^, m, or [N 3 h' w'] colours I^
  BasicTensor<T> alpha;   ///< [N h' w'] coverage
};

/// What the rendered surface of the stage before says about the heights of a stage:
///   dH = N(H) - up(N(H^)),  R = [dH, |dH|, C]
/// with N(X) = (X - median) / (MAD + 0.1 m) over a view's valid pixels, or dH = (H - up(H^)) /
/// interval. dH is clamped to 10 in size and 0 where the rendered surface covers less than half a
/// pixel or the view has no data.
/// stage     its image is not read
/// rendered  heights
/// returns   [N 3 h w], without gradients: guidance is no path of the loss
/// throws    ShapeError
/// Source: SatSurfGS, cross-stage residual guidance
template <class T>
BasicTensor<T> guidance_residual(const GuidedMaps<T>& stage, const RenderedMaps<T>& rendered,
                                 GuidanceNorm norm);

/// The same by colours: R = I - I^ of the images and the rendered ones, 0 where the surface covers
/// less than half a pixel or the view has no data.
/// stage     its image and validity are read
/// rendered  colours
/// returns   [N 3 h w], without gradients
/// throws    ShapeError
/// Source: after Tang et al. 2024 (HiSplat), whose later stages see the error of the earlier ones
template <class T>
BasicTensor<T> photometric_residual(const GuidedMaps<T>& stage, const RenderedMaps<T>& rendered);

/// Cross-stage residual guidance (CSRG): adds what the residual R says to the head's input X where
/// the input asks for it,
///   X' = X + sigmoid(w(X)) r(R)
/// with w two 3 x 3 convolutions of 32 channels between them and r two 1 x 1 ones, ReLU inside
/// both; the last layer of r starts at zero, so X' = X at the start.
/// Source: SatSurfGS, cross-stage residual guidance
template <class T>
class CrossStageGuidance {
 public:
  /// config    by colours where its guidance is photometric, else by heights
  /// channels  C of X
  CrossStageGuidance(ParameterSet<T>& p, const std::string& name, const ModelConfig& config,
                     Index channels);
  /// R of all views: renders the stage before into each of them and compares.
  /// returns  [N 3 h w], without gradients
  /// throws   ShapeError
  BasicVar<T> residual(const GuidedMaps<T>& stage, const StageOutput<T>& previous,
                       const std::vector<PosedImage>& views) const;
  /// X' of some of the views.
  /// x         [N C h w]
  /// residual  [N 3 h w]
  /// returns   [N C h w]
  /// throws    ShapeError
  BasicVar<T> operator()(const BasicVar<T>& x, const BasicVar<T>& residual) const;

 private:
  bool photometric_;
  GuidanceNorm norm_;
  Conv2d<T> gate1_, gate2_, residual1_, residual2_;
};

}  // namespace satsurf::nn

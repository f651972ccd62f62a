// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/blocks.h"

#include <string>

namespace satsurf::nn {

/// How rendered heights and those of the next stage are made comparable.
enum class GuidanceNorm {
  robust,   ///< each map by its own median and MAD: tells shape, not offset
  interval  ///< their difference in hypothesis intervals
};

/// What the surface of the stage before, rendered into each source view, says about the heights of
/// a stage:
///   dH = N(H) - up(N(H^)),  R = [dH, |dH|, C]
/// with N(X) = (X - median) / (MAD + 0.1 m) over a view's valid pixels, or dH = (H - up(H^)) /
/// interval. dH is clamped to 10 in size and 0 where the rendered surface covers less than half a
/// pixel or the view has no data.
/// height      [N h w] of the stage, m
/// confidence  [N h w] of the stage
/// valid       [N h w] share of the view's data behind each pixel
/// rendered    [N h' w'] of the stage before, m
/// alpha       [N h' w'] of that rendering
/// interval    between the stage's hypotheses, m
/// returns     [N 3 h w], without gradients: guidance is no path of the loss
/// throws      ShapeError
/// Source: SatSurfGS, cross-stage residual guidance
template <class T>
BasicTensor<T> guidance_residual(const BasicTensor<T>& height, const BasicTensor<T>& confidence,
                                 const BasicTensor<T>& valid, const BasicTensor<T>& rendered,
                                 const BasicTensor<T>& alpha, GuidanceNorm norm, double interval);

/// The same by colours: R = I - I^ of the images and the rendered ones, 0 where the surface covers
/// less than half a pixel or the view has no data.
/// image     [N 3 h w] of the stage
/// valid     [N h w] share of the view's data behind each pixel
/// rendered  [N 3 h' w'] of the stage before
/// alpha     [N h' w'] of that rendering
/// returns   [N 3 h w], without gradients
/// throws    ShapeError
/// Source: after Tang et al. 2024 (HiSplat), whose later stages see the error of the earlier ones
template <class T>
BasicTensor<T> photometric_residual(const BasicTensor<T>& image, const BasicTensor<T>& valid,
                                    const BasicTensor<T>& rendered, const BasicTensor<T>& alpha);

/// Adds what the residual says to the head's input where the input asks for it (CSRG):
///   X' = X + sigmoid(w(X)) r(R)
/// with w two 3 x 3 convolutions of 32 channels between them and r two 1 x 1 ones, ReLU inside
/// both; the last layer of r starts at zero, so X' = X at the start.
/// Source: SatSurfGS, cross-stage residual guidance
template <class T>
class Guidance {
 public:
  /// channels  of X
  Guidance(ParameterSet<T>& p, const std::string& name, Index channels);
  /// x         [N C h w]
  /// residual  [N 3 h w]
  /// returns   [N C h w]
  /// throws    ShapeError
  BasicVar<T> operator()(const BasicVar<T>& x, const BasicVar<T>& residual) const;

 private:
  Conv2d<T> gate1_, gate2_, residual1_, residual2_;
};

}  // namespace satsurf::nn

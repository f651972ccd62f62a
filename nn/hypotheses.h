// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/config.h"
#include "satsurf/nn/input.h"

#include <array>

namespace satsurf::nn {

/// Mean parallax over all ordered pairs of source views, at the window's centre.
/// returns  image pixels per metre of height
double mean_parallax(const NetworkInput& scene);

/// Distance between the hypotheses of each stage. The last stage's is `interval_px` of disparity,
/// clipped to [interval_min, interval_max]; the second's is twice that; the first divides the
/// scene's range evenly.
/// returns  m, coarse to fine
/// Source: after Gu et al. 2020 (CasMVSNet), with intervals by parallax instead of fixed ones.
std::array<double, 3> hypothesis_intervals(const ModelConfig& config, const NetworkInput& scene);

/// Stage 1: heights from low to high, both included, the same for every pixel.
/// low, high      m
/// views          N
/// hypotheses     D
/// height, width  of the stage's maps, px
/// returns        [N D H W] m
template <class T>
BasicTensor<T> uniform_hypotheses(double low, double high, Index views, Index hypotheses,
                                  Index height, Index width);

/// Later stages: heights around each pixel's centre height; a window that would leave [low, high]
/// is shifted back inside, not squeezed.
/// centre      [N H W] m
/// interval    between neighbouring hypotheses, m
/// hypotheses  D
/// low, high   m
/// returns     [N D H W] m
template <class T>
BasicTensor<T> narrowed_hypotheses(const BasicTensor<T>& centre, double interval, Index hypotheses,
                                   double low, double high);

/// Probability that the surface lies within `reach` of a pixel's height, where each hypothesis
/// stands for the interval around it.
/// probability, hypotheses  [N D H W]; m, evenly spaced
/// height                   [N H W] m
/// interval, reach          m
/// returns                  [N H W] in [0, 1]
/// throws                   ShapeError
template <class T>
BasicTensor<T> probability_within(const BasicTensor<T>& probability,
                                  const BasicTensor<T>& hypotheses, const BasicTensor<T>& height,
                                  double interval, double reach);

}  // namespace satsurf::nn

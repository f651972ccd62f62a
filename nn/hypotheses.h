// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/config.h"
#include "satsurf/nn/input.h"
#include "satsurf/nn/stage.h"

#include <array>

namespace satsurf::nn {

/// Mean parallax over all ordered pairs of source views, at the window's centre.
/// returns  image pixels per metre of height
double mean_parallax(const NetworkInput& scene);

/// Distance between the hypotheses of each stage. The last stage's is `interval_px` of disparity,
/// clipped to [interval_min, interval_max]; the second's is twice that; the first divides the
/// scene's range evenly.
/// returns  m, coarse to fine
/// throws   ConfigError if the scene's height range is empty
/// Source: after Gu et al. 2020 (CasMVSNet), with intervals by parallax instead of fixed ones.
std::array<double, 3> hypothesis_intervals(const ModelConfig& config, const NetworkInput& scene);

/// The three stages' sizes for a scene, coarse to fine.
/// throws  ConfigError as `hypothesis_intervals`
std::array<StageGrid, 3> stage_grids(const ModelConfig& config, const NetworkInput& scene);

/// The heights that one stage tries: the whole range first, then a narrow band around the surface of
/// the stage before, without its gradient.
/// scene     whose height range is searched
/// grid      of the stage
/// previous  nullptr for the first stage
/// centre    how its heights are interpolated
/// returns   [N D h w] m; empty where the stage does not search
template <class T>
BasicTensor<T> stage_hypotheses(const NetworkInput& scene, const StageGrid& grid,
                                const StageHeights<T>* previous, Centre centre);

/// Heights of coarse pixels for finer ones: each has that of the coarse pixel in which it lies,
/// continued along the slope there, in rows and in columns the smaller one of the differences to the
/// neighbours before and behind, none where the two have opposite signs. So it is exact on planes but
/// for their border, and at a wall it lies on the roof or on the ground.
/// coarse         [N h w] m
/// height, width  of the result
/// returns        [N height width] m
/// throws         ShapeError
/// Source: the minmod limiter of Roe 1986.
template <class T>
BasicTensor<T> along_slopes(const BasicTensor<T>& coarse, Index height, Index width);

/// Heights over a whole range, both ends included, the same for every pixel.
/// grid     its interval is not read
/// range    local m
/// returns  [N D h w] m
template <class T>
BasicTensor<T> uniform_hypotheses(const StageGrid& grid, const rpc::HeightRange& range);

/// Heights around each pixel's centre height; a window that would leave the range is shifted back
/// inside, not squeezed.
/// grid     of the stage
/// centre   [N h w] m
/// range    local m
/// returns  [N D h w] m
/// throws   ShapeError
template <class T>
BasicTensor<T> narrowed_hypotheses(const StageGrid& grid, const BasicTensor<T>& centre,
                                   const rpc::HeightRange& range);

}  // namespace satsurf::nn

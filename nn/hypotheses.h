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

/// How many heights the first stage tries: `hypotheses[0]`, or what it takes for neighbours to be
/// `first_interval_px` of disparity apart, up to `most_hypotheses`. So a generous range is searched
/// as closely as a tight one. Its 3D U-Net takes any number of them.
/// parallax  of the whole range, image pixels, see `mean_parallax`
/// returns   a multiple of what the U-Net halves
Index first_hypotheses(const ModelConfig& config, double parallax);

/// The three stages' sizes for a scene, coarse to fine. Of the intervals between hypotheses the last
/// stage's is `interval_px` of disparity, clipped to [interval_min, interval_max]; the second's is
/// twice that; the first divides the scene's range evenly.
/// wanted  surfels: their heads read the first stage's distribution, which then has `hypotheses[0]`
/// throws  ConfigError if the scene's height range is empty
/// Source: after Gu et al. 2020 (CasMVSNet), with intervals by parallax instead of fixed ones.
std::array<StageGrid, 3> stage_grids(const ModelConfig& config, const NetworkInput& scene,
                                     Wanted wanted = Wanted::surfels);

/// The heights that one stage tries: the whole range first, then a narrow band around the surface of
/// the stage before, without its gradient.
/// range     that is searched, local m
/// grid      of the stage
/// previous  nullptr for the first stage
/// centre    how its heights are interpolated
/// returns   [N D h w] m; empty where the stage does not search
template <class T>
BasicTensor<T> stage_hypotheses(const rpc::HeightRange& range, const StageGrid& grid,
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

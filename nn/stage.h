// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/var.h"
#include "satsurf/splat/rasterize.h"

#include <cstddef>

namespace satsurf::nn {

/// What a forward pass is asked for.
enum class Wanted {
  coarse_heights,  ///< the search of the first two stages alone; the third's output stays empty
  heights,         ///< the search alone: neither guidance nor surfels, a third less work
  discs,   ///< heights and, of the last stage's, surfels that are all alike; no distributions
  surfels  ///< all of it
};

/// How many of the three stages that takes.
constexpr std::size_t stages_of(Wanted wanted) { return wanted == Wanted::coarse_heights ? 2 : 3; }

/// Whether a loss may read what comes of it.
constexpr bool learns(Wanted wanted) {
  return wanted == Wanted::heights || wanted == Wanted::surfels;
}

/// The size of one stage of the cascade: of its maps [N h w] and volumes [N D h w], and where its
/// hypotheses lie.
struct StageGrid {
  Index views = 0;              ///< N
  Index height = 0, width = 0;  ///< h, w, stage pixels
  Index stride = 1;             ///< image pixels per stage pixel: 4, 2 or 1
  Index hypotheses = 0;         ///< D per pixel; 0 where the stage does not search
  double interval = 0;          ///< between hypotheses, m
  /// Half of the band that the next stage to search covers, m; 0 where none follows.
  double next_reach = 0;
};

/// The heights of one stage and how probable they are.
template <class T>
struct StageHeights {
  double interval = 0;          ///< between hypotheses, m
  BasicTensor<T> hypotheses{};  ///< [N D h w] m; empty where the stage does not search (D = 0)
  BasicVar<T> probability{};    ///< [N D h w] over the hypotheses, P_s; empty alike
  BasicVar<T> height{};         ///< [N h w] height H_s (see HeightOf), m in the local frame
  BasicVar<T> confidence{};     ///< [N h w] max probability C_s
  Index choices = 0;  ///< hypotheses behind the confidence: D, or those of the stage before
  /// [N h w] probability that the surface lies within an interval of H_s, given all stages so far;
  /// empty unless the configuration's confidence is `joint` (nn/confidence.h).
  BasicTensor<T> joint_confidence{};
};

/// What one stage of the cascade predicts for all N source views, at the stage's resolution.
template <class T>
struct StageOutput : StageHeights<T> {
  Index stride = 1;  ///< 4, 2 or 1 image pixels per stage pixel
  /// N*h*w pixel-aligned surfels, and behind them those of the stages before if the configuration
  /// keeps all; aux channel 0 is the effective confidence. None where only heights were wanted.
  splat::BasicSurfels<T> surfels;
  BasicTensor<T> mono_height;  ///< [N h w] of the monocular branch, relative; empty without one
};

}  // namespace satsurf::nn

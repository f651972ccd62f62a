// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/var.h"

#include <vector>

namespace satsurf {

/// Square patches that cover a map without overlap. Those that stick out are cut at the border, and
/// what is missing counts as not valid. Along an axis no longer than `side` there is one patch of
/// the axis's length, wherever the grid lies.
struct PatchGrid {
  Index side = 16;  ///< px, at least 2
  /// A corner of the grid, each in [0, side); drawn anew at every step, no patch border stays put.
  Index top = 0, left = 0;
};

struct PatchPearsonOptions {
  std::vector<PatchGrid> grids;  ///< at least one
  double min_valid = 0.25;       ///< share of valid pixels below which a patch is left out
  /// Patches with less of the target's deviation in the whole map than this share are left out:
  /// what they correlate with is noise.
  double flat = 1e-3;
  double eps = 1e-3;  ///< positive, in units of x: the deviation below which x counts as flat
};

/// Losses per pixel.
template <class T>
struct PatchPearson {
  BasicVar<T> local;       ///< [N H W] in [0, 2]
  BasicVar<T> global;      ///< [N H W]
  BasicTensor<T> defined;  ///< [N H W] 1 where some patch counts, else 0; the losses are 0 there
};

/// How far a map is from being a linear function of its target, patch by patch. Both losses ignore
/// the unit and the offset of the target. With m, s the means and deviations over the valid pixels
/// of the patch p of a pixel and S the deviations over all valid pixels of its view:
///   local  = 1 - rho_p,  rho_p = mean_p((x - m_x) (y - m_y)) / ((s_x + eps) s_y)
///   global = ((x - m_x) / (S_x + eps) - (y - m_y) / S_y)^2 / 2
/// averaged over those grids in which the pixel's patch counts. S_x is a constant to the backward
/// pass. Were the deviations those of the patch, the mean of `global` over it would be `local`.
/// Source: local and global patch normalisation after Li et al. 2024 (DNGaussian), here with the
/// correlation in place of their distance, population moments, and eps on the side of x only.
/// x        [N H W] N views; may be NaN where not valid
/// target   [N H W] any unit per view; may be NaN where not valid
/// valid    [N H W] 1 where a pixel counts and 0 where not, or an empty tensor for ones
/// options  grids and thresholds
/// throws   ShapeError, ConfigError
/// cost     moments in double, O(N H W) per grid; one map kept for backward, three with a mask
template <class T>
PatchPearson<T> patch_pearson(const BasicVar<T>& x, const BasicTensor<T>& target,
                              const BasicTensor<T>& valid, const PatchPearsonOptions& options);

}  // namespace satsurf

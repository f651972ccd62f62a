// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/var.h"

namespace satsurf {

struct SsiLossOptions {
  Index scales = 4;  ///< of the gradient loss: every pixel, every 2nd, every 4th, ..
  /// Positive, in units of x: the deviation below which x counts as flat.
  double eps = 1e-3;
  /// Maps whose target deviates by no more than this are left out: what is left of it once it is
  /// normalised is noise.
  double flat = 0;
};

template <class T>
struct SsiLoss {
  BasicVar<T> distance;  ///< scalar
  BasicVar<T> gradient;  ///< scalar
  Index maps = 0;        ///< that count; both losses are 0 without any
};

/// How far maps are from being increasing linear functions of their targets. With m the mean and
/// s = mean |x - m| the absolute deviation over the valid pixels of a map,
/// x^ = (x - m_x) / (s_x + eps), y^ = (y - m_y) / s_y and R = x^ - y^:
///   distance = mean |R|
///   gradient = sum_k ( mean |R[2^k i, 2^k (j + 1)] - R[2^k i, 2^k j]|
///                    + mean |R[2^k (i + 1), 2^k j] - R[2^k i, 2^k j]| )
/// Means are over a map's valid pixels or pairs of them, then over the maps that count.
/// Source: Ranftl et al. 2020 (MiDaS), eq. 6 and 11, here with the mean in place of the median, and
/// with means in place of sums per scale. Distance and deviation are both absolute for a reason:
/// with a standard deviation what a network is unsure of would go into a few high peaks, which make
/// the map vary at the least distance.
/// x        [N H W]; may be NaN where not valid
/// target   [N H W] any unit and offset per map; may be NaN where not valid
/// valid    [N H W] 1 where a pixel counts and 0 where not, or an empty tensor for ones
/// options  scales and thresholds
/// throws   ShapeError, ConfigError
/// cost     sums in double; two maps kept for backward, three with a mask
template <class T>
SsiLoss<T> ssi_loss(const BasicVar<T>& x, const BasicTensor<T>& target, const BasicTensor<T>& valid,
                    const SsiLossOptions& options = {});

}  // namespace satsurf

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <limits>
#include <vector>

namespace satsurf::reconstruct {

/// A surfel as a cell of the surface sees it.
struct CellCandidate {
  double z, weight, confidence;  ///< local m; > 0; in [0, 1]
};

/// What a cell decides on.
struct CellMode {
  double height = std::numeric_limits<double>::quiet_NaN();
  double confidence = std::numeric_limits<double>::quiet_NaN();
};

/// The densest mode of weighed heights: with the triangular kernel max(0, 1 - |d| / b) the density
/// is largest at one candidate, the lowest of those that come within a millionth of the largest.
/// The members of the mode are the candidates within b of that one.
/// candidates  in any order; may come back in another
/// b           half width of the kernel, m
/// returns     the members' mean height; their mean confidence times their share of the weight, all
///             by weight; NaN for no candidates
CellMode densest_mode(std::vector<CellCandidate>& candidates, double b);

/// A cell's heights in a few numbers; heights are NaN where there is none.
struct CellSummary {
  CellMode mode;
  double second = std::numeric_limits<double>::quiet_NaN();  ///< mode of all but its members
  double low = second, high = second;       ///< a tenth of the weight lies below, above, m
  double mode_share = 0, second_share = 0;  ///< of the weight
  double weight = 0, confidence = 0;        ///< sum; mean
  double spread = 0;                        ///< deviation of the heights, m
};

/// Sums a cell up.
/// candidates, b  as `densest_mode`
CellSummary summary_of(std::vector<CellCandidate>& candidates, double b);

}  // namespace satsurf::reconstruct

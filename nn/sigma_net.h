// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/blocks.h"

#include <array>
#include <string>

namespace satsurf::nn {

/// Heights that have been found, and what was said of them, all [H W]; no more than the heights counts
/// where there is none.
struct FoundSurface {
  Tensor heights;    ///< in intervals, NaN where there is none
  Tensor log_scale;  ///< logarithm of the expected error, in intervals
  Tensor sure;       ///< confidence of the surfels times the share of them that agree
  Tensor most;       ///< largest of the candidates' weights
  Tensor spread;     ///< the candidates' distance from the height, in intervals
};

/// Half the sides of the squares around a cell that are looked at, less the cell: 3 to 61 cells.
inline constexpr std::array<Index, 4> kSigmaRadii{1, 4, 12, 30};
/// What is known of a cell, and of each square around it.
inline constexpr Index kSigmaChannels = 4 + 8 * static_cast<Index>(kSigmaRadii.size());

/// What a cell's expected error is judged by: what was said of it, and of the cells around the mean;
/// of the expected errors there the least and the largest; how far the height is from the lowest, the
/// highest and the mean one. Squares are cut off at the edges and have no holes in them.
/// returns  [1 C H W], C = kSigmaChannels; 0 in holes
/// throws   ShapeError
Tensor sigma_channels(const FoundSurface& found);

/// Says better than the network that found the heights, which is asked for them first, how large an
/// error to expect: where roofs end, by how much they rise and how unsure the cells around are. It sees
/// each cell by itself; what is around is in the channels.
template <class T>
class SigmaNet {
 public:
  /// name    before the names of its parameters, with its dot
  /// hidden  channels between
  SigmaNet(ParameterSet<T>& parameters, const std::string& name, Index hidden);
  /// channels  as `sigma_channels` makes them, [1 C H W]
  /// returns   [H W] what to add to the logarithm of the expected error
  BasicVar<T> operator()(const Tensor& channels) const;

 private:
  Conv2d<T> first_, second_, head_;
};

}  // namespace satsurf::nn

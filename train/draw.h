// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/rng.h"
#include "satsurf/core/shape.h"

#include <algorithm>
#include <cstddef>
#include <numeric>
#include <utility>
#include <vector>

namespace satsurf::train {

// What samples are made of. A checkpoint goes on bit for bit only where a seed gives the same numbers
// in the same order: what is drawn here stays as it is.

/// The numbers 0 to `count` - 1 in random order.
inline std::vector<Index> shuffled(Index count, Rng& rng) {
  std::vector<Index> order(static_cast<std::size_t>(count));
  std::iota(order.begin(), order.end(), Index{0});
  for (std::size_t i = order.size(); i-- > 1;)
    std::swap(order[i], order[static_cast<std::size_t>(rng.below(static_cast<Index>(i) + 1))]);
  return order;
}

/// The middle of a random window along one axis of an image: the window lies inside where the image
/// is large enough, else it has its middle where the image has it.
/// side    of the window, px
/// extent  of the image, px
/// returns px
inline double window_middle(Index side, Index extent, Rng& rng) {
  const double half = 0.5 * static_cast<double>(std::min(side, extent));
  return rng.uniform(half - 0.5, std::max(half, static_cast<double>(extent) - half) - 0.5);
}

}  // namespace satsurf::train

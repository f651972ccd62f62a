// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

namespace satsurf::app {

/// A rectangle of a figure by its middle, px.
struct Box {
  double x = 0, y = 0, width = 0, height = 0;
};

/// Finds room for labels: no two of them overlap, nor one of them and what is to stay in sight. Each
/// lies as near to its place as there is room, away from the middle of all; earlier ones come first.
/// labels   each where what it names lies
/// taken    what is to stay in sight
/// within   the figure
/// nearest  distance from their places at least, 0 to lie on them
/// returns  the labels where they go; one that finds no room stays on its place
std::vector<Box> spread(const std::vector<Box>& labels, const std::vector<Box>& taken,
                        const Box& within, double nearest);

}  // namespace satsurf::app

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/scene/scene.h"

#include <functional>

namespace satsurf::scene {

/// Heights between which a surface lies, m.
struct FoundHeights {
  rpc::HeightRange agreed;  ///< at which the images agree
  rpc::HeightRange range;   ///< with what may stand out of that

  friend bool operator==(const FoundHeights&, const FoundHeights&) = default;
};

/// Height range of a scene that names none: a coarse sweep by normalised correlation of the first
/// view with the others, and of what it does not show in the others among themselves. Of three views
/// and more it is made twice, with the mean of all correlations of a pixel and with that of the better
/// half of them. What lies far from the rest counts if other views find it, too, when they are compared
/// with all others; what only one of the two ways finds far off counts if two views do.
/// searched  range to search, as a rule the cameras' own, local m
/// poll      called often, may throw to stop
/// unwanted  whether heights found over a point of the ground, local m, do not count; may be empty
/// throws    Error naming the images that have no texture or do not agree anywhere, or the only one
FoundHeights find_height_range(const Scene& scene, const rpc::HeightRange& searched,
                               const std::function<void()>& poll = {},
                               const std::function<bool(double, double)>& unwanted = {});

}  // namespace satsurf::scene

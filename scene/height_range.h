// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/scene/scene.h"

#include <functional>
#include <vector>

namespace satsurf::scene {

/// Height range of a scene that names none: a coarse sweep by normalised correlation of the views.
/// searched  range to search, as a rule the cameras' own, local m
/// poll      called often, may throw to stop
/// unwanted  whether heights found over a point of the ground, local m, do not count; may be empty
/// returns   lowest and highest height, local m
/// throws    Error naming the images that have no texture or do not agree anywhere
rpc::HeightRange find_height_range(const Scene& scene, const rpc::HeightRange& searched,
                                   const std::function<void()>& poll = {},
                                   const std::function<bool(double, double)>& unwanted = {});

/// Lowest and highest height that is found more often than chance finds it. Chance matches are
/// few and anywhere in the searched range; what lies outside the middle nine tenths shows how
/// few.
/// heights   at least one, local m
/// searched  range they were looked for in
rpc::HeightRange believable_span(std::vector<float> heights, const rpc::HeightRange& searched);

}  // namespace satsurf::scene

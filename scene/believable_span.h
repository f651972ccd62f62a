// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/shape.h"
#include "satsurf/rpc/height_range.h"

#include <cstddef>
#include <functional>
#include <optional>
#include <vector>

namespace satsurf::scene {

/// Heights of neighbouring pixels, local m.
using Patch = std::vector<float>;

constexpr double kNear = 20;          ///< m from all others up to which heights are close together
constexpr double kLargestStep = 100;  ///< m between heights of one scene with none in between

/// Lowest and highest height that is found more often than chance finds it. Chance matches are
/// few and anywhere in the searched range; what lies outside the middle nine tenths shows how
/// few.
/// heights       at least one, local m
/// searched      range they were looked for in
/// largest_step  m with nothing in between; beyond it is another pattern
/// quantile      of the numbers of heights in each 10 m outside the middle nine tenths that is taken
///               for chance: less than the median where the surface may fill more than half of them
rpc::HeightRange believable_span(std::vector<float> heights, const rpc::HeightRange& searched,
                                 double largest_step = kLargestStep, double quantile = 0.5);

/// The span of heights but for a share of them on either side.
/// heights  at least one
rpc::HeightRange span_of_all_but(double share, std::vector<float> heights);

/// The span of what lies close together, no more than 20 m beyond the rest.
/// heights, searched  see `believable_span`
rpc::HeightRange near_span(std::vector<float> heights, const rpc::HeightRange& searched);

/// A span, and of patches beyond it the ones that are confirmed, from the nearest to the farthest and in
/// steps of up to 100 m.
/// confirmed  whether a patch is more than chance; asked of those that would widen the span, and told
///            how many m lie between it and the span so far, less than 0 where it overlaps
rpc::HeightRange widened(rpc::HeightRange span, const std::vector<Patch>& patches,
                         const std::function<bool(std::size_t, double)>& confirmed);

/// What two ways to find a span say of it: all that either found up to 25 m beyond what both did. As
/// chance finds other heights each way, what only one of them found farther off is not believed. All
/// of both where they have nothing in common.
/// a, b  nothing where a way found too little
std::optional<rpc::HeightRange> confirmed_span(const std::optional<rpc::HeightRange>& a,
                                               const std::optional<rpc::HeightRange>& b);

}  // namespace satsurf::scene

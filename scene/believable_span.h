// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/shape.h"
#include "satsurf/rpc/height_range.h"

#include <optional>
#include <vector>

namespace satsurf::scene {

/// Heights of neighbouring pixels, local m.
using Patch = std::vector<float>;

/// Lowest and highest height that is found more often than chance finds it. Chance matches are
/// few and anywhere in the searched range; what lies outside the middle nine tenths shows how
/// few.
/// heights       at least one, local m
/// searched      range they were looked for in
/// largest_step  m with nothing in between; beyond it is another pattern
rpc::HeightRange believable_span(std::vector<float> heights, const rpc::HeightRange& searched,
                                 double largest_step = 100);

/// `believable_span` of heights in patches. One that lies more than 50 m above or below all others
/// counts only if it is large, as towers and the ground below cliffs are and chance is not.
/// patches  with at least one height
/// large    pixels
rpc::HeightRange span_of_patches(const std::vector<Patch>& patches,
                                 const rpc::HeightRange& searched, Index large);

/// What two ways to find a span say of it: all that either found up to 25 m beyond what both did. As
/// chance finds other heights each way, what only one of them found farther off is not believed. All
/// of both where they have nothing in common.
/// a, b  nothing where a way found too little
std::optional<rpc::HeightRange> confirmed_span(const std::optional<rpc::HeightRange>& a,
                                               const std::optional<rpc::HeightRange>& b);

}  // namespace satsurf::scene

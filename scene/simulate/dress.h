// SPDX-License-Identifier: Apache-2.0
// What the parts of buildings look like, and the pieces all plans are put together from.
#pragma once

#include "satsurf/scene/simulate/draw.h"
#include "satsurf/scene/simulate/layout.h"

namespace satsurf::scene::simulate {

inline Colour grey(float g, float warm = 1.0f) { return {g * warm, g, g / warm}; }

Colour flat_roof_colour(Rng& rng);
Colour pitched_roof_colour(Rng& rng);

/// Walls: colour, storeys, windows.
void dress_walls(Rng& rng, Part& part);
/// A flat roof of any colour and covering, with or without parapet.
void dress_flat_roof(Rng& rng, Part& part);
/// A membrane of one colour, mostly white, without joints or stains that a satellite would see.
void dress_membrane(Rng& rng, Part& part);
/// Adds small solids to a flat roof: air conditioning, stair heads, vents, tanks; `rarity` times
/// fewer than on an office block.
void clutter(Layout& layout, Rng& rng, const Part& on, float rarity = 1);

/// A part around (u, v) along the streets with half extents a and b, m; nothing else is set.
Part part_at(const Layout& layout, float u, float v, float a, float b);
/// Moves a part along its own axes, m.
void slide(Part& part, float along, float across);
/// Lowest and mean height of the ground under a part; false where it would stand in or by the
/// water, or on a lane.
bool ground_under(const Layout& layout, const Part& part, float& low, float& mean);

/// What `add_building` puts on a lot: each takes the outline of the lot's building, dressed, with
/// base and eave set, and adds its parts.
void add_courtyard(Layout& layout, Rng& rng, const Part& outline);
/// A block pierced by one or two shafts.
void add_atrium(Layout& layout, Rng& rng, const Part& outline);
/// An L, T, U or H of wings that may differ in height.
void add_wings(Layout& layout, Rng& rng, const Part& outline);
/// Storeys that step back from one or two sides, or from all, as they rise.
void add_tiers(Layout& layout, Rng& rng, const Part& outline, int tiers);
/// Open decks with cars on the uppermost.
void add_car_park(Layout& layout, Rng& rng, Part outline);
/// A hall of the lot's size: white or grey, flat or nearly, with little on it; trucks at its docks.
void add_hall(Layout& layout, Rng& rng, Part outline);
/// A roof on posts.
void add_canopy(Layout& layout, Rng& rng, Part outline);
/// The same with the plan (u0..u1) x (v0..v1) along the streets, unless water is in the way.
void add_canopy(Layout& layout, Rng& rng, float u0, float u1, float v0, float v1);

}  // namespace satsurf::scene::simulate

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/simulate/dress.h"

#include <algorithm>
#include <cmath>

namespace satsurf::scene::simulate {
namespace {

// The piece of an outline between two shares of each of its axes, from -1 to 1.
Part piece(const Part& outline, float u0, float u1, float v0, float v1) {
  Part p = outline;
  slide(p, 0.5f * (u0 + u1) * outline.a, 0.5f * (v0 + v1) * outline.b);
  p.a = 0.5f * (u1 - u0) * outline.a;
  p.b = 0.5f * (v1 - v0) * outline.b;
  return p;
}

void turn_quarter(Part& p) {
  const float c = p.cos;
  p.cos = -p.sin;
  p.sin = c;
  std::swap(p.a, p.b);
}

void add(Layout& layout, Rng& r, const Part& p, float rarity = 1) {
  layout.parts.push_back(p);
  clutter(layout, r, p, rarity);
}

}  // namespace

void add_courtyard(Layout& layout, Rng& r, const Part& outline) {
  const float depth = draw(r, 4.5, 6.5), pitch = r.chance(0.6) ? draw(r, 0.25, 0.7) : 0.0f,
              storeys = outline.eave - outline.base;
  const Colour cover = pitched_roof_colour(r);
  for (int k = 0; k < 4; ++k) {
    Part wing = outline;
    const bool along_u = k < 2;
    const float side = k % 2 == 0 ? 1.0f : -1.0f;
    slide(wing, along_u ? 0.0f : side * (outline.a - depth),
          along_u ? side * (outline.b - depth) : 0.0f);
    wing.a = along_u ? outline.a : depth;
    wing.b = along_u ? depth : outline.b;
    if (!along_u) turn_quarter(wing);
    wing.eave = outline.base + storeys * (k == 3 && r.chance(0.3) ? 0.5f : 1.0f);
    if (pitch > 0) {
      wing.roof = Roof::hip;
      wing.rise = std::min(pitch * depth, 4.0f);
      wing.pattern = RoofPattern::tiles;
      wing.pattern_period = 0.45f;
      wing.roof_colour = cover;
    }
    add(layout, r, wing);
  }
}

void add_atrium(Layout& layout, Rng& r, const Part& outline) {
  // One shaft, or two beside each other along the longer side.
  Part p = outline;
  if (p.a < p.b) turn_quarter(p);
  const int shafts = p.a > 1.7f * p.b && r.chance(0.6) ? 2 : 1;
  const float wall_v = draw(r, 0.35, 0.65);  // share of the half width left on either side
  const float across = 1 - wall_v, each = 1.0f / static_cast<float>(shafts);
  add(layout, r, piece(p, -1, 1, across, 1));
  add(layout, r, piece(p, -1, 1, -1, -across));
  const float along = each * draw(r, 0.35, 0.7);
  float at = -1;
  for (int k = 0; k < shafts; ++k) {
    const float centre = -1 + each * static_cast<float>(2 * k + 1);
    add(layout, r, piece(p, at, centre - along, -across, across));
    at = centre + along;
    if (r.chance(0.4)) {  // glazed over, some storeys up
      Part glass = piece(p, centre - along, centre + along, -across, across);
      glass.eave = p.base + (p.eave - p.base) * draw(r, 0.2, 0.8);
      glass.rise = 0;
      glass.roof_colour = {0.14f, 0.17f, 0.2f};
      glass.pattern = RoofPattern::sheets;
      glass.pattern_period = draw(r, 1.5, 3);
      layout.parts.push_back(glass);
    }
  }
  add(layout, r, piece(p, at, 1, -across, across));
}

void add_wings(Layout& layout, Rng& r, const Part& outline) {
  Part p = outline;
  if (r.chance(0.5)) turn_quarter(p);
  if (r.chance(0.5)) {  // open to the other side
    p.cos = -p.cos;
    p.sin = -p.sin;
  }
  const float storeys = p.eave - p.base;
  const auto lower = [&](Part wing) {
    if (r.chance(0.4)) wing.eave = wing.base + std::max(3.0f, storeys * draw(r, 0.3, 0.95));
    if (r.chance(0.25)) wing.roof_colour = flat_roof_colour(r);
    add(layout, r, wing);
  };
  const float bar = draw(r, 0.35, 0.6);  // half width of the bar, of the outline's
  const float foot = 2 * bar - 1, thick = draw(r, 0.3, 0.6);  // where it ends; width of the wings
  const double plan = r.uniform();
  if (plan < 0.75) {
    add(layout, r, piece(p, -1, 1, -1, foot));
    if (plan < 0.3) {  // L
      lower(piece(p, -1, 2 * thick - 1, foot, 1));
    } else if (plan < 0.5) {  // T
      const float centre = draw(r, -0.3, 0.3);
      lower(piece(p, centre - thick, centre + thick, foot, 1));
    } else {  // U
      lower(piece(p, -1, thick - 1, foot, draw(r, 0.6, 1.0)));
      lower(piece(p, 1 - thick, 1, foot, 1));
    }
  } else {  // H
    const float half = draw(r, 0.2, 0.45);
    add(layout, r, piece(p, -1, thick - 1, -1, 1));
    add(layout, r, piece(p, 1 - thick, 1, -1, draw(r, 0.5, 1.0)));
    lower(piece(p, thick - 1, 1 - thick, -half, half));
  }
}

void add_tiers(Layout& layout, Rng& r, const Part& outline, int tiers) {
  Part p = outline;
  const float storeys = p.eave - p.base;
  const bool terraced = r.chance(0.45);  // from one side alone, as stairs
  float height = terraced ? draw(r, 0.15, 0.4) : draw(r, 0.15, 0.6);
  for (int k = 0; k < tiers; ++k) {
    const bool top = k + 1 == tiers;
    p.eave = outline.base + storeys * (top ? 1.0f : height);
    if (p.eave - p.base > 2.5f) add(layout, r, p, top ? 1.0f : 3.0f);
    height += (1 - height) * draw(r, 0.3, 0.8);
    const Part below = p;
    const float u = draw(r, 0.6, 0.92), v = draw(r, 0.6, 0.92);
    if (terraced) {
      p.a *= u;
      slide(p, below.a - p.a, 0);
    } else {
      p.a *= u;
      p.b *= v;
      slide(p, draw(r, -0.9, 0.9) * (below.a - p.a), draw(r, -0.9, 0.9) * (below.b - p.b));
    }
    if (std::min(p.a, p.b) < 4) break;
    p.base = below.eave;
    if (r.chance(0.4)) p.roof_colour = flat_roof_colour(r);
  }
}

void add_car_park(Layout& layout, Rng& r, Part p) {
  p.roof = Roof::flat;
  p.rise = draw(r, 0.9, 1.2);
  const float g = draw(r, 0.2, 0.42);
  p.roof_colour = grey(g, draw(r, 1.0, 1.06));
  p.wall_colour = p.parapet_colour = grey(draw(r, 0.3, 0.5), 1.03f);
  p.pattern = RoofPattern::plain;
  p.texture = draw(r, 0.8, 2.5);
  p.storey = 3;
  p.window_share = 0.75f;
  p.ribbon_windows = true;
  layout.parts.push_back(p);
  const float share = r.chance(0.3) ? 0.0f : draw(r, 0.1, 0.9), period = draw(r, 2.5, 2.9);
  for (float v = -p.b + 3.5f; v < p.b - 3.5f; v += r.chance(0.5) ? 5.2f : 10.8f) {
    for (float u = -p.a + 3; u < p.a - 3; u += period) {
      if (!r.chance(share)) continue;
      Part at = p;
      slide(at, u, v);
      Car car{.x = at.x, .y = at.y, .cos = -p.sin, .sin = p.cos, .length = draw(r, 4, 5)};
      car.colour = car_colour(r);
      car.deck = true;
      (r.chance(0.3) ? layout.cars : layout.visitors).push_back(car);
    }
  }
  Part stairs = p;  // to the deck
  stairs.a = draw(r, 1.5, 3.5);
  stairs.b = draw(r, 1.5, 3.5);
  slide(stairs, (r.chance(0.5) ? 1.0f : -1.0f) * (p.a - stairs.a),
        (r.chance(0.5) ? 1.0f : -1.0f) * (p.b - stairs.b));
  stairs.base = p.eave;
  stairs.eave = p.eave + draw(r, 2.5, 3.8);
  stairs.rise = stairs.window_share = 0;
  layout.parts.push_back(stairs);
}

void add_hall(Layout& layout, Rng& r, Part p) {
  dress_membrane(r, p);
  p.window_share = r.chance(0.7) ? 0.0f : draw(r, 0.2, 0.5);
  if (p.a < p.b) turn_quarter(p);
  const double form = r.uniform();
  const float rarity = draw(r, 4, 60);
  if (form < 0.2) {  // a ridge so low that it shows by its two shades alone
    p.roof = r.chance(0.7) ? Roof::gable : Roof::shed;
    p.rise = draw(r, 0.5, 2.5);
    layout.parts.push_back(p);
  } else if (form < 0.55) {  // halls of different heights in one
    const float cut = draw(r, -0.6, 0.6), storeys = p.eave - p.base;
    Part low = piece(p, cut, 1, -1, r.chance(0.6) ? 1.0f : draw(r, -0.2, 0.8));
    low.eave = p.base + std::max(3.5f, storeys * draw(r, 0.45, 0.9));
    if (r.chance(0.5)) dress_membrane(r, low);
    add(layout, r, piece(p, -1, cut, -1, 1), rarity);
    add(layout, r, low, rarity);
  } else {
    add(layout, r, p, rarity);
  }
  if (r.chance(0.3) && p.roof == Roof::flat) {  // rows of skylights
    const float pitch = draw(r, 6, 14), wide = draw(r, 0.6, 1.2), lift = draw(r, 0.2, 0.7);
    for (float v = -p.b + 0.7f * pitch; v < p.b - 0.5f * pitch; v += pitch) {
      Part light = p;
      slide(light, 0, v);
      light.a = 0.85f * p.a;
      light.b = wide;
      light.base = p.eave;
      light.eave = p.eave + lift;
      light.rise = light.window_share = 0;
      light.roof_colour = grey(draw(r, 0.35, 0.6), 0.96f);
      layout.parts.push_back(light);
    }
  }
  if (!r.chance(0.6)) return;
  // Docks: trucks square to one long side, on some dates.
  const float side = r.chance(0.5) ? 1.0f : -1.0f, pitch = draw(r, 4, 6);
  for (float u = -0.9f * p.a; u < 0.9f * p.a; u += pitch) {
    if (!r.chance(0.5)) continue;
    Part at = p;
    const float length = draw(r, 8, 15);
    slide(at, u, side * (p.b + 0.5f * length + 0.6f));
    Car truck{.x = at.x, .y = at.y, .cos = -p.sin, .sin = p.cos, .length = length};
    truck.width = 2.55f;
    truck.tall = draw(r, 3.2, 4.1);
    truck.colour = r.chance(0.7) ? grey(draw(r, 0.5, 0.8)) : car_colour(r);
    (r.chance(0.2) ? layout.cars : layout.visitors).push_back(truck);
  }
}

void add_canopy(Layout& layout, Rng& r, Part p) {
  dress_membrane(r, p);
  p.rise = 0;
  p.open = true;
  p.window_share = 0;
  p.wall_colour = p.roof_colour;
  p.eave = p.base + draw(r, 3.5, 6.5);
  layout.parts.push_back(p);
}

void add_canopy(Layout& layout, Rng& r, float u0, float u1, float v0, float v1) {
  Part p = part_at(layout, 0.5f * (u0 + u1), 0.5f * (v0 + v1), 0.5f * (u1 - u0), 0.5f * (v1 - v0));
  float low = 0, mean = 0;
  if (!ground_under(layout, p, low, mean)) return;
  p.base = mean;
  add_canopy(layout, r, p);
}

}  // namespace satsurf::scene::simulate

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/simulate/dress.h"

#include <algorithm>
#include <cmath>

namespace satsurf::scene::simulate {

void add_building(Layout& layout, Rng& r, float u0, float u1, float v0, float v1, float height) {
  const float du = u1 - u0, dv = v1 - v0;
  if (std::min(du, dv) < 4) return;
  // room for parapet and roof clutter
  const auto cap = static_cast<float>(layout.plan.tallest) - 4.5f;
  Part p = part_at(layout, 0.5f * (u0 + u1), 0.5f * (v0 + v1), 0.5f * du, 0.5f * dv);
  float low = 0, mean = 0;
  if (!ground_under(layout, p, low, mean)) return;
  dress_walls(r, p);
  dress_flat_roof(r, p);
  p.base = low;
  // From the lowest ground up, or a slope could lift the roof above the tallest height.
  p.eave = low + std::min(std::max(height, mean - low + 2.5f), cap);
  const float storeys = p.eave - low;

  if (r.chance(0.07) &&
      std::max(du, dv) < 1.6f * std::min(du, dv)) {  // out of line with the street
    const float turn = draw(r, -0.7, 0.7), c = p.cos;
    p.cos = c * std::cos(turn) - p.sin * std::sin(turn);
    p.sin = p.sin * std::cos(turn) + c * std::sin(turn);
    p.a *= 0.7f;
    p.b *= 0.7f;
    layout.parts.push_back(p);
    clutter(layout, r, p);
    return;
  }
  const double shape = r.uniform();
  const float narrow = std::min(du, dv), wide = std::max(du, dv);
  if (narrow > 38 && storeys < 18 && r.chance(0.7)) return add_hall(layout, r, p);
  if (narrow > 24 && wide < 110 && storeys > 6 && storeys < 24 && r.chance(0.10))
    return add_car_park(layout, r, p);
  if (narrow > 8 && wide < 40 && storeys < 12 && r.chance(0.06)) return add_canopy(layout, r, p);
  if (narrow > 30 && r.chance(0.45)) {  // one roof for many rooms
    const float rise = p.rise;
    dress_membrane(r, p);
    p.rise = rise;
  }
  if (wide < 45 && shape < 0.04) {
    p.round = true;
    p.a = p.b = std::min(p.a, p.b);
  } else if (shape < 0.12 && narrow > 28 && storeys < 28) {
    return add_courtyard(layout, r, p);
  } else if (shape < 0.20 && narrow > 20) {
    return add_atrium(layout, r, p);
  } else if (shape < 0.38 && narrow > 14) {
    return add_wings(layout, r, p);
  } else if (shape < 0.68 && storeys > 9 && narrow > 12) {
    return add_tiers(layout, r, p, 2 + static_cast<int>(storeys > 30 ? r.below(3) : r.below(2)));
  } else if (storeys < 15 && r.chance(0.35)) {  // halls and older houses
    const float half = std::min(p.a, p.b);
    if (p.a < p.b) {  // the ridge runs along the first axis
      std::swap(p.a, p.b);
      const float c = p.cos;
      p.cos = -p.sin;
      p.sin = c;
    }
    const double kind = r.uniform();
    p.roof = kind < 0.45  ? Roof::gable
             : kind < 0.7 ? Roof::hip
             : kind < 0.8 ? Roof::shed
             : kind < 0.9 ? Roof::barrel
                          : Roof::sawtooth;
    p.rise = std::min({half * draw(r, 0.12, 0.6), 5.0f, cap + 4.0f - storeys});
    p.pattern = r.chance(0.5) ? RoofPattern::seams : RoofPattern::tiles;
    p.pattern_period = p.pattern == RoofPattern::seams ? draw(r, 0.5, 1.5) : draw(r, 0.35, 0.6);
    if (r.chance(0.6)) p.roof_colour = pitched_roof_colour(r);
  }
  layout.parts.push_back(p);
  clutter(layout, r, p);
}

void add_house(Layout& layout, Rng& r, float u, float v) {
  const float a = draw(r, 4.5, 9), b = draw(r, 3.5, std::min(6.5f, a));
  Part p = part_at(layout, u, v, a, b);
  const float turn = r.chance(0.8) ? 0.0f : draw(r, -0.4, 0.4);
  const float c = p.cos * std::cos(turn) - p.sin * std::sin(turn);
  p.sin = p.sin * std::cos(turn) + p.cos * std::sin(turn);
  p.cos = c;
  if (r.chance(0.3)) {
    p.cos = -p.sin;
    p.sin = c;
  }
  float low = 0, mean = 0;
  if (!ground_under(layout, p, low, mean)) return;
  dress_walls(r, p);
  p.base = low;
  p.eave = std::max(mean, low) + draw(r, 2.6, 6.2);
  p.roof = r.chance(0.55) ? Roof::gable : r.chance(0.85) ? Roof::hip : Roof::flat;
  p.rise = p.roof == Roof::flat ? 0.4f : p.b * draw(r, 0.3, 0.85);
  p.roof_colour = pitched_roof_colour(r);
  p.parapet_colour = grey(draw(r, 0.3, 0.6));
  p.pattern = r.chance(0.1) ? RoofPattern::plain : RoofPattern::tiles;
  p.pattern_period = draw(r, 0.3, 0.6);
  layout.parts.push_back(p);
  if (r.chance(0.45)) {  // a wing, or a garage
    Part wing = p;
    const float side = r.chance(0.5) ? 1.0f : -1.0f, along = draw(r, -0.5, 0.5) * p.a;
    wing.a = p.b * draw(r, 0.5, 0.9);
    wing.b = draw(r, 2.2, 3.6);
    wing.cos = -p.sin;
    wing.sin = p.cos;
    wing.x = p.x + along * p.cos - side * p.b * p.sin;
    wing.y = p.y + along * p.sin + side * p.b * p.cos;
    wing.eave = std::min(p.eave, low + draw(r, 2.6, 6));
    wing.rise = wing.b * p.rise / std::max(p.b, 1.0f);
    layout.parts.push_back(wing);
  }
  if (r.chance(0.5) && p.roof != Roof::flat) {
    Part chimney = p;
    const float du = draw(r, -0.7, 0.7) * p.a, dv = draw(r, -0.4, 0.4) * p.b;
    chimney.x += du * p.cos - dv * p.sin;
    chimney.y += du * p.sin + dv * p.cos;
    chimney.a = chimney.b = draw(r, 0.3, 0.5);
    chimney.eave = p.eave + p.rise + draw(r, 0.4, 1.0);
    chimney.base = p.eave;
    chimney.roof = Roof::flat;
    chimney.rise = chimney.window_share = 0;
    chimney.pattern = RoofPattern::plain;
    chimney.roof_colour = {0.3f, 0.2f, 0.15f};
    layout.parts.push_back(chimney);
  }
}

}  // namespace satsurf::scene::simulate

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/simulate/layout.h"

#include <algorithm>
#include <cmath>

namespace satsurf::scene::simulate {
namespace {

float draw(Rng& rng, double low, double high) { return static_cast<float>(rng.uniform(low, high)); }

Colour grey(float g, float warm = 1.0f) { return {g * warm, g, g / warm}; }

Colour flat_roof_colour(Rng& r) {
  const double u = r.uniform();
  if (u < 0.22) return grey(draw(r, 0.55, 0.85));                       // white membrane
  if (u < 0.58) return grey(draw(r, 0.22, 0.45), draw(r, 0.98, 1.06));  // gravel, concrete
  if (u < 0.78) return grey(draw(r, 0.07, 0.18));                       // bitumen
  if (u < 0.92) return {draw(r, 0.22, 0.34), draw(r, 0.17, 0.25), draw(r, 0.13, 0.19)};
  return {draw(r, 0.08, 0.2), draw(r, 0.16, 0.28), draw(r, 0.14, 0.3)};  // coated metal
}

Colour pitched_roof_colour(Rng& r) {
  const double u = r.uniform(), b = r.uniform(0.7, 1.3);
  const auto s = static_cast<float>(b);
  if (u < 0.40) return {0.34f * s, 0.17f * s, 0.11f * s};  // clay tiles
  if (u < 0.65) return grey(draw(r, 0.08, 0.2), 1.02f);    // slate, shingles
  if (u < 0.85) return {0.24f * s, 0.19f * s, 0.15f * s};
  return grey(draw(r, 0.3, 0.55));
}

Colour wall_colour(Rng& r) {
  const double u = r.uniform();
  if (u < 0.5) return grey(draw(r, 0.25, 0.6), draw(r, 1.0, 1.1));
  if (u < 0.7) return {draw(r, 0.25, 0.4), draw(r, 0.14, 0.2), draw(r, 0.1, 0.15)};  // brick
  if (u < 0.85) return grey(draw(r, 0.1, 0.2), 0.95f);                               // glass
  return grey(draw(r, 0.55, 0.8));
}

// Range of the ground under a part; false where it would stand in or by the water or off the field.
bool ground_under(const Layout& layout, const Part& p, float& low, float& mean) {
  low = 1e9f;
  mean = 0;
  constexpr std::array<std::array<float, 2>, 9> kSpots{
      {{0, 0}, {1, 1}, {1, -1}, {-1, 1}, {-1, -1}, {1, 0}, {-1, 0}, {0, 1}, {0, -1}}};
  for (const auto& q : kSpots) {
    const float du = q[0] * p.a, dv = q[1] * p.b;
    const float x = p.x + du * p.cos - dv * p.sin, y = p.y + du * p.sin + dv * p.cos;
    if (!layout.shore.empty() && layout.at(layout.shore, x, y) < 3) return false;
    if (!layout.lane.empty() && std::abs(layout.at(layout.lane, x, y)) < layout.lane_half_width + 1)
      return false;
    const float z = layout.at(layout.terrain, x, y);
    low = std::min(low, z);
    mean += z / static_cast<float>(kSpots.size());
  }
  return true;
}

Part part_at(const Layout& layout, float u, float v, float a, float b) {
  const Streets& s = layout.streets;
  Part p{};
  p.x = u * s.cos - v * s.sin;
  p.y = u * s.sin + v * s.cos;
  p.cos = s.cos;
  p.sin = s.sin;
  p.a = a;
  p.b = b;
  return p;
}

void dress_walls(Rng& r, Part& p) {
  p.wall_colour = wall_colour(r);
  p.storey = draw(r, 2.9, 4.0);
  p.window_pitch = draw(r, 1.6, 4.5);
  p.window_share = r.chance(0.15) ? 0.0f : draw(r, 0.3, 0.75);
  p.ribbon_windows = r.chance(0.3);
  p.seed = static_cast<std::uint32_t>(r.next_u64());
}

void dress_flat_roof(Rng& r, Part& p) {
  p.roof = Roof::flat;
  p.roof_colour = flat_roof_colour(r);
  p.rise = r.chance(0.75) ? draw(r, 0.3, 1.2) : 0.0f;
  p.parapet_colour = grey(draw(r, 0.3, 0.7));
  const double u = r.uniform();
  p.pattern = u < 0.25   ? RoofPattern::plain
              : u < 0.45 ? RoofPattern::gravel
              : u < 0.62 ? RoofPattern::seams
              : u < 0.93 ? RoofPattern::sheets
                         : RoofPattern::panels;
  p.pattern_period = p.pattern == RoofPattern::seams ? draw(r, 0.6, 2.5) : draw(r, 3, 9);
}

// Air conditioning, stair heads, vents, tanks: small solids on a flat roof.
void clutter(Layout& layout, Rng& r, const Part& on) {
  if (on.roof != Roof::flat || on.pattern == RoofPattern::panels) return;
  const float area = 4 * on.a * on.b;
  const int n = static_cast<int>(area / draw(r, 60, 400)) + (r.chance(0.5) ? 1 : 0);
  const Colour common = grey(draw(r, 0.3, 0.7));
  for (int k = 0; k < std::min(n, 40); ++k) {
    Part p = on;
    const bool small = r.chance(0.7), duct = r.chance(0.12);
    p.a = small ? draw(r, 0.4, 1.2) : draw(r, 1.2, std::max(1.3f, 0.25f * on.a));
    p.b = small ? draw(r, 0.4, 1.2) : draw(r, 1.0, std::max(1.1f, 0.3f * on.b));
    if (duct) {
      p.a = draw(r, 0.15, 0.65) * on.a;
      p.b = draw(r, 0.3, 0.6);
    }
    if (p.a > 0.7f * on.a || p.b > 0.7f * on.b) continue;
    const float du = draw(r, -1, 1) * (on.a - p.a - 0.6f),
                dv = draw(r, -1, 1) * (on.b - p.b - 0.6f);
    p.x = on.x + du * on.cos - dv * on.sin;
    p.y = on.y + du * on.sin + dv * on.cos;
    p.base = on.eave;
    p.eave = on.eave + (small ? draw(r, 0.5, 1.6) : draw(r, 1.5, 3.8));
    p.round = !duct && r.chance(0.15);
    if (p.round) p.b = p.a;
    p.rise = 0;
    p.roof_colour = small ? common : flat_roof_colour(r);
    p.wall_colour = grey(draw(r, 0.2, 0.6));
    p.window_share = 0;
    p.pattern = RoofPattern::plain;
    p.seed = static_cast<std::uint32_t>(r.next_u64());
    layout.parts.push_back(p);
  }
}

// Four wings around a yard.
void add_courtyard(Layout& layout, Rng& r, const Part& outline, float storeys) {
  const float depth = draw(r, 4.5, 6.5), pitch = r.chance(0.6) ? draw(r, 0.25, 0.7) : 0.0f;
  const Colour cover = pitched_roof_colour(r);
  for (int k = 0; k < 4; ++k) {
    Part wing = outline;
    const bool along_u = k < 2;
    const float side = k % 2 == 0 ? 1.0f : -1.0f;
    const float du = along_u ? 0.0f : side * (outline.a - depth);
    const float dv = along_u ? side * (outline.b - depth) : 0.0f;
    wing.x += du * outline.cos - dv * outline.sin;
    wing.y += du * outline.sin + dv * outline.cos;
    wing.a = along_u ? outline.a : outline.b;
    wing.b = depth;
    if (!along_u) {
      wing.cos = -outline.sin;
      wing.sin = outline.cos;
    }
    wing.eave = outline.base + storeys * (k == 3 && r.chance(0.3) ? 0.5f : 1.0f);
    if (pitch > 0) {
      wing.roof = Roof::hip;
      wing.rise = std::min(pitch * depth, 4.0f);
      wing.pattern = RoofPattern::tiles;
      wing.pattern_period = 0.45f;
      wing.roof_colour = cover;
    }
    layout.parts.push_back(wing);
    clutter(layout, r, wing);
  }
}

}  // namespace

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
  const bool slender = std::max(du, dv) < 45;
  if (slender && shape < 0.04) {
    p.round = true;
    p.a = p.b = std::min(p.a, p.b);
  } else if (shape < 0.14 && std::min(du, dv) > 28 && storeys < 28) {
    add_courtyard(layout, r, p, storeys);
    return;
  } else if (shape < 0.28 && std::min(du, dv) > 14) {  // two wings
    Part wing = p;
    const float cut = draw(r, 0.35, 0.6), side = r.chance(0.5) ? 1.0f : -1.0f;
    const float along = r.chance(0.5) ? 1.0f : -1.0f;
    p.b *= cut;
    p.x -= side * (0.5f * dv - p.b) * -p.sin;
    p.y -= side * (0.5f * dv - p.b) * p.cos;
    wing.a *= draw(r, 0.3, 0.5);
    wing.x += along * (0.5f * du - wing.a) * wing.cos;
    wing.y += along * (0.5f * du - wing.a) * wing.sin;
    if (r.chance(0.4)) wing.eave = low + std::max(3.0f, storeys * draw(r, 0.4, 0.9));
    layout.parts.push_back(wing);
    clutter(layout, r, wing);
  } else if (shape < 0.55 && storeys > 9 && std::min(du, dv) > 12) {  // a podium below a slab
    Part podium = p;
    podium.eave = low + std::max(4.0f, storeys * draw(r, 0.15, 0.6));
    podium.roof_colour = flat_roof_colour(r);
    layout.parts.push_back(podium);
    clutter(layout, r, podium);
    p.base = podium.eave;
    const float keep_a = draw(r, 0.35, 0.85), keep_b = draw(r, 0.35, 0.85);
    const float slide_u = draw(r, -1, 1) * (1 - keep_a) * p.a,
                slide_v = draw(r, -1, 1) * (1 - keep_b) * p.b;
    p.x += slide_u * p.cos - slide_v * p.sin;
    p.y += slide_u * p.sin + slide_v * p.cos;
    p.a *= keep_a;
    p.b *= keep_b;
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

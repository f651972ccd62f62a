// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/simulate/dress.h"

#include <algorithm>
#include <cmath>

namespace satsurf::scene::simulate {
namespace {

Colour wall_colour(Rng& r) {
  const double u = r.uniform();
  if (u < 0.5) return grey(draw(r, 0.25, 0.6), draw(r, 1.0, 1.1));
  if (u < 0.7) return {draw(r, 0.25, 0.4), draw(r, 0.14, 0.2), draw(r, 0.1, 0.15)};  // brick
  if (u < 0.85) return grey(draw(r, 0.1, 0.2), 0.95f);                               // glass
  return grey(draw(r, 0.55, 0.8));
}

}  // namespace

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

void slide(Part& p, float along, float across) {
  p.x += along * p.cos - across * p.sin;
  p.y += along * p.sin + across * p.cos;
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
  if (p.pattern == RoofPattern::panels) p.roof_colour = grey(draw(r, 0.2, 0.45));
  p.pattern_period = p.pattern == RoofPattern::seams ? draw(r, 0.6, 2.5) : draw(r, 3, 9);
}

void dress_membrane(Rng& r, Part& p) {
  p.roof = Roof::flat;
  const double u = r.uniform();
  p.roof_colour = u < 0.42   ? grey(draw(r, 0.55, 0.9), draw(r, 0.98, 1.02))
                  : u < 0.68 ? grey(draw(r, 0.25, 0.45), draw(r, 0.97, 1.05))
                  : u < 0.82 ? grey(draw(r, 0.08, 0.2))
                  : u < 0.94 ? Colour{draw(r, 0.2, 0.34), draw(r, 0.16, 0.27), draw(r, 0.12, 0.2)}
                             : Colour{draw(r, 0.12, 0.3), draw(r, 0.18, 0.3), draw(r, 0.15, 0.3)};
  p.rise = r.chance(0.5) ? draw(r, 0.2, 0.9) : 0.0f;
  p.parapet_colour = r.chance(0.5) ? p.roof_colour : grey(draw(r, 0.4, 0.8));
  p.pattern = r.chance(0.8) ? RoofPattern::plain : RoofPattern::seams;
  p.pattern_period = draw(r, 0.6, 3);
  p.texture = draw(r, 0.0, 0.5);
}

void clutter(Layout& layout, Rng& r, const Part& on, float rarity) {
  if (on.roof != Roof::flat || on.pattern == RoofPattern::panels) return;
  const float area = 4 * on.a * on.b;
  const int n = static_cast<int>(area / (rarity * draw(r, 60, 400))) + (r.chance(0.5) ? 1 : 0);
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
    p.texture = 1;
    p.seed = static_cast<std::uint32_t>(r.next_u64());
    layout.parts.push_back(p);
  }
}

}  // namespace satsurf::scene::simulate

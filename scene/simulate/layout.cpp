// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/simulate/dress.h"
#include "satsurf/scene/simulate/noise.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace satsurf::scene::simulate {
namespace {

// How a kind of town is laid out; lengths in m, shares in [0, 1].
struct Fabric {
  double block_u, block_v;                    // mean distances between streets
  double half_width, pavement;                // of a street
  double built, houses, parking, park, bare;  // shares of the blocks; what is left is crops
  double lot;                                 // side of a building's lot
  double low, high;                           // usual heights of buildings
  double towers;                              // chance that a building is a tower
  double groves;                              // tree cover of open ground
  double whole;                               // chance that one building takes a built block
};

Fabric fabric_of(SceneKind kind, Rng& rng) {
  switch (kind) {
    case SceneKind::city:
      return {88, 98, 6.8, 3, 0.82, 0.02, 0.08, 0.05, 0.02, 34, 7, 28, 0.3, 0.10, 0.16};
    case SceneKind::suburb:
      return {75, 110, 4.2, 1.8, 0.10, 0.72, 0.05, 0.10, 0.03, 26, 4, 10, 0.01, 0.30, 0.35};
    case SceneKind::industrial:
      return {140, 115, 6, 1.5, 0.66, 0, 0.18, 0.05, 0.10, 60, 6, 15, 0.04, 0.06, 0.45};
    case SceneKind::village:
      return {62, 80, 3.2, 1, 0.12, 0.60, 0.04, 0.14, 0.05, 20, 5, 11, 0, 0.35, 0.05};
    case SceneKind::rural:
      return {170, 140, 2.4, 0, 0.03, 0.08, 0, 0.10, 0.12, 24, 4, 8, 0, 0.25, 0.2};
    case SceneKind::rough:
      break;
  }
  return {1e6, 1e6, 0, 0, 0, 0, 0, 0, 0, 20, 4, 8, 0, rng.uniform(0.1, 0.7), 0};
}

std::vector<float> street_lines(Rng& rng, double spacing, float reach) {
  std::vector<float> lines;
  float at = -reach - draw(rng, 0, spacing);
  while (at < reach + static_cast<float>(spacing)) {
    lines.push_back(at);
    at += static_cast<float>(spacing) * draw(rng, 0.7, 1.35);
  }
  lines.push_back(at);
  return lines;
}

Colour grass_colour(Rng& rng) {
  const float dry = draw(rng, 0, 1);
  return {0.085f + 0.11f * dry, 0.105f + 0.075f * dry, 0.055f + 0.05f * dry};
}

Colour soil_colour(Rng& rng) {
  const float b = draw(rng, 0.6, 1.25), red = draw(rng, 0.95, 1.15);
  return {0.235f * b * red, 0.20f * b, 0.16f * b};
}

class Furnisher {
 public:
  Furnisher(Layout& layout, const Rng& rng) : layout_(layout), rng_(rng) {}

  void run() {
    Rng r = rng_.fork(1);
    layout_.deciduous = r.chance(0.25) ? 0.0f : draw(r, 0.3, 1.0);
    Fabric f = fabric_of(layout_.plan.kind, r);
    // Some towns have narrow blocks and streets, some wide ones.
    const double grain = r.uniform(0.75, 1.35);
    f.block_u *= grain;
    f.block_v *= grain;
    const bool dense = layout_.plan.kind == SceneKind::city && r.chance(0.4);
    if (dense) {
      f.half_width *= 0.7;
      f.towers = layout_.plan.tallest > 60 ? 0.5 : 0.35;
    }
    Streets& s = layout_.streets;
    const float angle = draw(r, 0, 2 * std::numbers::pi), reach = 1.45f * layout_.half_side();
    s.cos = std::cos(angle);
    s.sin = std::sin(angle);
    s.half_width = static_cast<float>(f.half_width) * draw(r, 0.8, 1.3);
    s.pavement = static_cast<float>(f.pavement) * draw(r, 0.5, 1.4);
    s.marked = f.half_width > 4;
    const float worn = draw(r, 0.8, 2.4);
    s.colour = layout_.plan.kind == SceneKind::rural
                   ? soil_colour(r)
                   : Colour{0.105f * worn, 0.105f * worn, 0.108f * worn};
    if (f.block_u < 1e5) {
      s.u_lines = street_lines(r, f.block_u, reach);
      s.v_lines = street_lines(r, f.block_v, reach);
    } else {
      s.u_lines = s.v_lines = {-1e6f, 1e6f};
      s.half_width = s.pavement = 0;
    }
    const std::size_t U = s.u_lines.size() - 1, V = s.v_lines.size() - 1;
    for (std::size_t v = 0; v < V; ++v) {
      for (std::size_t u = 0; u < U; ++u) add_block(f, u, v, rng_.fork(16 + v * 4096 + u));
    }
    const double spacing =
        layout_.plan.kind == SceneKind::rough ? r.uniform(1.8, 4) : r.uniform(4.5, 7);
    // Half of the places where rock stands out are above the trees.
    const bool bare = layout_.plan.crags && rng_.fork(5).chance(0.5);
    add_groves(layout_, rng_.fork(2), static_cast<float>(bare ? 0 : f.groves),
               static_cast<float>(spacing),
               layout_.plan.kind == SceneKind::rough ? draw(r, 1.2, 4.5) : draw(r, 3, 6));
    if (f.block_u < 1e5) traffic(rng_.fork(3));
    if (layout_.plan.kind == SceneKind::city || layout_.plan.kind == SceneKind::suburb ||
        layout_.plan.kind == SceneKind::industrial) {
      elevated_road(rng_.fork(4));
    }
  }

 private:
  void add_block(const Fabric& f, std::size_t iu, std::size_t iv, Rng r) {
    const Streets& s = layout_.streets;
    const float kerb = s.half_width;
    Block b{s.u_lines[iu] + kerb,
            s.u_lines[iu + 1] - kerb,
            s.v_lines[iv] + kerb,
            s.v_lines[iv + 1] - kerb,
            Ground::wild,
            soil_colour(r),
            1,
            r.chance(0.5),
            static_cast<std::uint32_t>(r.next_u64())};
    const double pick = r.uniform();
    if (f.block_u > 1e5) {
      layout_.blocks.push_back(b);
      return;
    }
    if (pick < f.built) {
      b.ground = r.chance(0.7) ? Ground::paved : Ground::lawn;
      const float g = draw(r, 0.14, 0.36);
      b.colour = b.ground == Ground::paved ? Colour{g * 1.04f, g, g * 0.93f} : grass_colour(r);
      buildings(f, b, r);
      tree_rows(b, r);
    } else if (pick < f.built + f.houses) {
      b.ground = Ground::lawn;
      b.colour = grass_colour(r);
      houses(b, r);
    } else if (pick < f.built + f.houses + f.parking) {
      b.ground = Ground::parking;
      const float g = draw(r, 0.09, 0.22);
      b.colour = {g, g, g};
      b.row_period = draw(r, 2.5, 2.9);
      parking(b, r);
      tree_rows(b, r);
    } else if (pick < f.built + f.houses + f.parking + f.park) {
      b.ground = Ground::lawn;
      b.colour = grass_colour(r);
      scatter_trees(b, r, draw(r, 0.002, 0.012));
    } else if (pick < f.built + f.houses + f.parking + f.park + f.bare) {
      b.ground = Ground::bare;
      site(b, r);
    } else {
      b.ground = Ground::crop;
      b.row_period = draw(r, 0.7, 4.5);
      if (r.chance(0.6)) b.colour = grass_colour(r);
    }
    layout_.blocks.push_back(b);
  }

  // Splits a rectangle along its longer side until the pieces have the size of a lot.
  void buildings(const Fabric& f, const Block& b, Rng& r) {
    struct Lot {
      float u0, u1, v0, v1;
    };
    const float pave = layout_.streets.pavement + 1;
    std::vector<Lot> open{{b.u0 + pave, b.u1 - pave, b.v0 + pave, b.v1 - pave}};
    // A mall, a plant, a block of one building: its lot is the block, or two thirds of it.
    const bool whole = r.chance(f.whole);
    const float large = whole ? draw(r, 0.65, 1.1) * std::max(b.u1 - b.u0, b.v1 - b.v0) : 0;
    while (!open.empty()) {
      const Lot lot = open.back();
      open.pop_back();
      const float du = lot.u1 - lot.u0, dv = lot.v1 - lot.v0, longer = std::max(du, dv);
      if (std::min(du, dv) < 6) continue;
      if (longer > std::max(large, static_cast<float>(f.lot) * draw(r, 0.8, 2.2))) {
        const float cut = draw(r, 0.35, 0.65);
        if (du > dv) {
          open.push_back({lot.u0, lot.u0 + cut * du, lot.v0, lot.v1});
          open.push_back({lot.u0 + cut * du, lot.u1, lot.v0, lot.v1});
        } else {
          open.push_back({lot.u0, lot.u1, lot.v0, lot.v0 + cut * dv});
          open.push_back({lot.u0, lot.u1, lot.v0 + cut * dv, lot.v1});
        }
        continue;
      }
      if (!whole && r.chance(0.12)) {  // an empty lot, where people park
        if (!r.chance(0.6)) continue;
        const float share = draw(r, 0.1, 0.9);
        for (float v = lot.v0 + 3; v < lot.v1 - 3; v += 7.5f) {
          for (float u = lot.u0 + 2; u < lot.u1 - 2; u += 2.7f) {
            if (r.chance(share)) place_car(layout_.visitors, r, u, v, false);
          }
        }
        continue;
      }
      const float gap = r.chance(0.4) ? draw(r, 0, 0.6) : draw(r, 1, 5);
      const bool tower = std::min(du, dv) < 60 && r.chance(f.towers);
      const float height = tower ? draw(r, f.high, std::max(f.high + 1, layout_.plan.tallest - 5))
                                 : draw(r, f.low, f.low + (f.high - f.low) * r.uniform());
      add_building(layout_, r, lot.u0 + gap, lot.u1 - gap, lot.v0 + gap, lot.v1 - gap, height);
    }
  }

  void houses(const Block& b, Rng& r) {
    const float width = draw(r, 15, 24), setback = draw(r, 9, 14);
    const int rows = b.v1 - b.v0 > 4.2f * setback ? 3 : b.v1 - b.v0 > 2.4f * setback ? 2 : 1;
    for (float u = b.u0 + 0.6f * width; u < b.u1 - 0.4f * width; u += width * draw(r, 0.85, 1.2)) {
      for (int k = 0; k < rows; ++k) {
        if (r.chance(0.1)) continue;
        const float mid = 0.5f * (b.v0 + b.v1);
        const float v = k == 0 ? b.v0 + setback : k == 1 ? b.v1 - setback : mid;
        add_house(layout_, r, u + draw(r, -1.5, 1.5), (rows == 1 ? mid : v) + draw(r, -2, 2));
      }
    }
    scatter_trees(b, r, draw(r, 0.001, 0.007));
  }

  void place_car(std::vector<Car>& cars, Rng& r, float u, float v, bool along_u,
                 double lorries = 0.01) {
    const Streets& s = layout_.streets;
    const float x = u * s.cos - v * s.sin, y = u * s.sin + v * s.cos, reach = layout_.half_side();
    if (std::max(std::abs(x), std::abs(y)) > reach) return;
    if (!layout_.shore.empty() && layout_.at(layout_.shore, x, y) < 2) return;
    const float turn = draw(r, -0.04, 0.04), c = (along_u ? s.cos : -s.sin) - turn * s.sin,
                d = (along_u ? s.sin : s.cos) + turn * s.cos;
    Car car{.x = x, .y = y, .cos = c, .sin = d, .length = draw(r, 4.0, 5.0)};
    car.colour = car_colour(r);
    if (r.chance(lorries)) {  // or a van
      car.length = draw(r, 6, 13);
      car.width = draw(r, 2.1, 2.5);
      car.tall = draw(r, 2.4, 3.8);
      if (r.chance(0.6)) car.colour = grey(draw(r, 0.5, 0.75));
    }
    cars.push_back(car);
  }

  // Double rows of stalls with aisles of 6 m, as the painted stall lines in city.cpp.
  void parking(const Block& b, Rng& r) {
    const float share = draw(r, 0.1, 0.9), from = b.rows_along_u ? b.u0 : b.v0,
                to = b.rows_along_u ? b.u1 : b.v1, first = b.rows_along_u ? b.v0 : b.u0,
                last = b.rows_along_u ? b.v1 : b.u1;
    const double roofed = r.chance(0.3) ? r.uniform(0.1, 0.6) : 0.0;
    for (float row = first + 3; row + 13.5f < last; row += 16) {
      if (r.chance(roofed)) {  // a roof on posts over both rows of stalls
        const float start = from + 4 + draw(r, 0, 0.3) * (to - from), end = to - 4;
        const float u = b.rows_along_u ? start : row, v = b.rows_along_u ? row : start;
        if (end - start > 8) {
          add_canopy(layout_, r, u, b.rows_along_u ? end : row + 10.4f, v,
                     b.rows_along_u ? row + 10.4f : end);
        }
      }
      for (float at = from + 3; at + b.row_period < to - 3; at += b.row_period) {
        for (const float across : {2.6f, 7.8f}) {
          if (!r.chance(share)) continue;
          const float a = at + 0.5f * b.row_period, c = row + across;
          auto& list = r.chance(0.25) ? layout_.cars : layout_.visitors;
          b.rows_along_u ? place_car(list, r, a, c, false) : place_car(list, r, c, a, true);
        }
      }
    }
  }

  // A building site: machines, huts and a crane's mast, on some dates.
  void site(const Block& b, Rng& r) {
    if (layout_.plan.kind == SceneKind::rural || !r.chance(0.6)) return;
    const int things = 2 + static_cast<int>(r.below(10));
    for (int k = 0; k < things; ++k) {
      const std::size_t before = layout_.visitors.size();
      place_car(layout_.visitors, r, draw(r, b.u0 + 4, b.u1 - 4), draw(r, b.v0 + 4, b.v1 - 4),
                r.chance(0.5));
      if (layout_.visitors.size() == before) continue;
      Car& c = layout_.visitors.back();
      c.length = draw(r, 3, 10);
      c.width = draw(r, 2, 3.5);
      c.tall = draw(r, 2, 3.5);
      c.colour = r.chance(0.5) ? Colour{0.55f, 0.38f, 0.05f} : grey(draw(r, 0.2, 0.7));
      if (k > 0 || layout_.plan.tallest < 30) continue;
      c.length = c.width = 1.8f;
      c.tall = draw(r, 20, std::min(layout_.plan.tallest - 2, 60.0));
      c.colour = r.chance(0.5) ? Colour{0.6f, 0.42f, 0.04f} : Colour{0.5f, 0.08f, 0.05f};
    }
  }

  void traffic(Rng r) {
    const Streets& s = layout_.streets;
    const float reach = layout_.half_side() * 1.4f, lane = 0.35f * s.half_width,
                edge = s.half_width - 1.2f;
    for (int family = 0; family < 2; ++family) {
      for (const float line : family == 0 ? s.u_lines : s.v_lines) {
        for (float at = -reach; at < reach; at += draw(r, 7, s.marked ? 30 : 70)) {
          const bool parked = s.half_width > 3.5f && r.chance(0.5);
          const float side = (r.chance(0.5) ? 1.0f : -1.0f) * (parked ? edge : lane);
          auto& list = parked && r.chance(0.4) ? layout_.cars : layout_.visitors;
          const double lorries = layout_.plan.kind == SceneKind::industrial ? 0.2 : 0.08;
          family == 0 ? place_car(list, r, line + side, at, false, lorries)
                      : place_car(list, r, at, line + side, true, lorries);
        }
      }
    }
  }

  // A road on posts along one of the streets, or the bridge of that street where there is water.
  void elevated_road(Rng r) {
    const Streets& s = layout_.streets;
    if (!r.chance(layout_.plan.water ? 0.4 : 0.12)) return;
    const bool along_v = r.chance(0.5);
    const std::vector<float>& lines = along_v ? s.u_lines : s.v_lines;
    const float wanted = draw(r, -0.5, 0.5) * layout_.half_side();
    const float line = *std::min_element(lines.begin(), lines.end(), [&](float one, float other) {
      return std::abs(one - wanted) < std::abs(other - wanted);
    });
    const float reach = 1.45f * layout_.half_side(), wide = s.half_width * draw(r, 0.8, 1.1);
    Part p =
        along_v ? part_at(layout_, line, 0, wide, reach) : part_at(layout_, 0, line, reach, wide);
    float top = -1e9f, low = 1e9f;
    for (float at = -reach; at < reach; at += 4) {
      const float u = along_v ? line : at, v = along_v ? at : line;
      const float z = layout_.at(layout_.terrain, u * s.cos - v * s.sin, u * s.sin + v * s.cos);
      top = std::max(top, z);
      low = std::min(low, z);
    }
    p.base = low;
    p.eave = std::min(top + draw(r, 4.5, 8), static_cast<float>(layout_.plan.relief) + 12);
    p.rise = draw(r, 0.6, 1.1);
    p.open = true;
    p.window_share = 0;
    p.roof_colour = r.chance(0.5) ? s.colour : grey(draw(r, 0.2, 0.35), 1.03f);
    p.wall_colour = p.parapet_colour = grey(draw(r, 0.3, 0.5), 1.02f);
    p.texture = 1.5f;
    layout_.parts.push_back(p);
    for (float at = -reach; at < reach; at += draw(r, 8, 40)) {
      const float lane = (r.chance(0.5) ? 1.0f : -1.0f) * 0.4f * wide;
      const std::size_t before = layout_.visitors.size();
      along_v ? place_car(layout_.visitors, r, line + lane, at, false, 0.15)
              : place_car(layout_.visitors, r, at, line + lane, true, 0.15);
      if (layout_.visitors.size() > before) layout_.visitors.back().deck = true;
    }
  }

  void add_tree(Rng& r, float u, float v, float radius) {
    const Streets& s = layout_.streets;
    const float x = u * s.cos - v * s.sin, y = u * s.sin + v * s.cos;
    if (!layout_.shore.empty() && layout_.at(layout_.shore, x, y) < 2) return;
    if (!layout_.lane.empty() &&
        std::abs(layout_.at(layout_.lane, x, y)) < layout_.lane_half_width + radius)
      return;
    const float tone = draw(r, 0.6, 1.5), warm = draw(r, 0.8, 1.4);
    layout_.trees.push_back({x,
                             y,
                             radius,
                             std::min(radius * draw(r, 1.3, 2.6), 22.0f),
                             layout_.at(layout_.terrain, x, y),
                             {0.042f * tone * warm, 0.065f * tone, 0.030f * tone},
                             static_cast<std::uint32_t>(r.next_u64())});
    layout_.trees.back().deciduous = r.chance(layout_.deciduous);
  }

  void scatter_trees(const Block& b, Rng& r, float per_m2) {
    const float radius = draw(r, 1.5, 4);
    const int n = static_cast<int>((b.u1 - b.u0) * (b.v1 - b.v0) * per_m2);
    for (int k = 0; k < n; ++k) {
      add_tree(r, draw(r, b.u0, b.u1), draw(r, b.v0, b.v1), radius * draw(r, 0.6, 1.7));
    }
  }

  void tree_rows(const Block& b, Rng& r) {
    if (!r.chance(0.45)) return;
    const float spacing = draw(r, 6, 14), radius = draw(r, 1.2, 3.2), inset = 1.2f;
    for (float u = b.u0 + 2; u < b.u1 - 2; u += spacing) {
      if (r.chance(0.85)) add_tree(r, u, b.v0 + inset, radius * draw(r, 0.8, 1.2));
      if (r.chance(0.85)) add_tree(r, u, b.v1 - inset, radius * draw(r, 0.8, 1.2));
    }
  }

  Layout& layout_;
  Rng rng_;
};

}  // namespace

Colour car_colour(Rng& rng) {
  const double u = rng.uniform();
  if (u < 0.30) return {0.72f, 0.72f, 0.72f};
  if (u < 0.50) return {0.03f, 0.03f, 0.035f};
  if (u < 0.72) return {0.35f, 0.36f, 0.38f};
  if (u < 0.82) return {0.26f, 0.06f, 0.05f};
  if (u < 0.92) return {0.07f, 0.09f, 0.16f};
  return {0.30f, 0.26f, 0.16f};
}

void furnish(Layout& layout, const Rng& rng) { Furnisher(layout, rng).run(); }

}  // namespace satsurf::scene::simulate

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/simulate/layout.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace satsurf::scene::simulate {
namespace {

float draw(Rng& rng, double low, double high) { return static_cast<float>(rng.uniform(low, high)); }

// How a kind of town is laid out; lengths in m, shares in [0, 1].
struct Fabric {
  double block_u, block_v;                    // mean distances between streets
  double half_width, pavement;                // of a street
  double built, houses, parking, park, bare;  // shares of the blocks; what is left is crops
  double lot;                                 // side of a building's lot
  double low, high;                           // usual heights of buildings
  double towers;                              // chance that a building is a tower
  double groves;                              // tree cover of open ground
};

Fabric fabric_of(SceneKind kind, Rng& rng) {
  switch (kind) {
    case SceneKind::city:
      return {88, 98, 6.8, 3, 0.82, 0.02, 0.08, 0.05, 0.02, 34, 7, 28, 0.3, 0.10};
    case SceneKind::suburb:
      return {75, 110, 4.2, 1.8, 0.10, 0.72, 0.05, 0.10, 0.03, 26, 4, 10, 0.01, 0.30};
    case SceneKind::industrial:
      return {140, 115, 6, 1.5, 0.66, 0, 0.18, 0.05, 0.10, 60, 6, 15, 0.04, 0.06};
    case SceneKind::village:
      return {62, 80, 3.2, 1, 0.12, 0.60, 0.04, 0.14, 0.05, 20, 5, 11, 0, 0.35};
    case SceneKind::rural:
      return {170, 140, 2.4, 0, 0.03, 0.08, 0, 0.10, 0.12, 24, 4, 8, 0, 0.25};
    case SceneKind::rough:
      break;
  }
  return {1e6, 1e6, 0, 0, 0, 0, 0, 0, 0, 20, 4, 8, 0, rng.uniform(0.1, 0.7)};
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

Colour car_colour(Rng& rng) {
  const double u = rng.uniform();
  if (u < 0.30) return {0.72f, 0.72f, 0.72f};
  if (u < 0.50) return {0.03f, 0.03f, 0.035f};
  if (u < 0.72) return {0.35f, 0.36f, 0.38f};
  if (u < 0.82) return {0.26f, 0.06f, 0.05f};
  if (u < 0.92) return {0.07f, 0.09f, 0.16f};
  return {0.30f, 0.26f, 0.16f};
}

class Furnisher {
 public:
  Furnisher(Layout& layout, const Rng& rng) : layout_(layout), rng_(rng) {}

  void run() {
    Rng r = rng_.fork(1);
    const Fabric f = fabric_of(layout_.plan.kind, r);
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
    add_groves(layout_, rng_.fork(2), static_cast<float>(f.groves), static_cast<float>(spacing),
               layout_.plan.kind == SceneKind::rough ? draw(r, 1.2, 4.5) : draw(r, 3, 6));
    if (f.block_u < 1e5) traffic(rng_.fork(3));
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
    while (!open.empty()) {
      const Lot lot = open.back();
      open.pop_back();
      const float du = lot.u1 - lot.u0, dv = lot.v1 - lot.v0, longer = std::max(du, dv);
      if (std::min(du, dv) < 6) continue;
      if (longer > static_cast<float>(f.lot) * draw(r, 0.8, 2.2)) {
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
      if (r.chance(0.12)) continue;  // an empty lot
      const float gap = r.chance(0.4) ? draw(r, 0, 0.6) : draw(r, 1, 5);
      const bool tower = r.chance(f.towers);
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

  void place_car(std::vector<Car>& cars, Rng& r, float u, float v, bool along_u) {
    const Streets& s = layout_.streets;
    const float x = u * s.cos - v * s.sin, y = u * s.sin + v * s.cos, reach = layout_.half_side();
    if (std::max(std::abs(x), std::abs(y)) > reach) return;
    if (!layout_.shore.empty() && layout_.at(layout_.shore, x, y) < 2) return;
    const float turn = draw(r, -0.04, 0.04), c = (along_u ? s.cos : -s.sin) - turn * s.sin,
                d = (along_u ? s.sin : s.cos) + turn * s.cos;
    cars.push_back({x, y, c, d, r.chance(0.9) ? draw(r, 4.0, 5.0) : draw(r, 6, 9), car_colour(r)});
  }

  // Double rows of stalls with aisles of 6 m, as the painted stall lines in city.cpp.
  void parking(const Block& b, Rng& r) {
    const float share = draw(r, 0.1, 0.9), from = b.rows_along_u ? b.u0 : b.v0,
                to = b.rows_along_u ? b.u1 : b.v1, first = b.rows_along_u ? b.v0 : b.u0,
                last = b.rows_along_u ? b.v1 : b.u1;
    for (float row = first + 3; row + 13.5f < last; row += 16) {
      for (float at = from + 3; at + b.row_period < to - 3; at += b.row_period) {
        for (const float across : {2.6f, 7.8f}) {
          if (!r.chance(share)) continue;
          const float a = at + 0.5f * b.row_period, c = row + across;
          auto& list = r.chance(0.4) ? layout_.cars : layout_.visitors;
          b.rows_along_u ? place_car(list, r, a, c, false) : place_car(list, r, c, a, true);
        }
      }
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
          family == 0 ? place_car(list, r, line + side, at, false)
                      : place_car(list, r, at, line + side, true);
        }
      }
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

void furnish(Layout& layout, const Rng& rng) { Furnisher(layout, rng).run(); }

void add_groves(Layout& layout, const Rng& rng, float density, float spacing, float radius) {
  Rng r = rng.fork(0);
  const float reach = layout.half_side();
  // Clumps: sums of a few waves of 20 to 120 m, cheaper than a noise grid and as irregular at this
  // scale.
  std::array<std::array<float, 3>, 6> waves{};
  for (auto& w : waves) {
    const float k = 6.2832f / draw(r, 20, 120), a = draw(r, 0, 6.2832);
    w = {k * std::cos(a), k * std::sin(a), draw(r, 0, 6.2832)};
  }
  const bool conifers = r.chance(0.3), wild = layout.plan.kind == SceneKind::rough;
  const auto boulders = static_cast<std::uint32_t>(r.chance(0.6) ? r.uniform(0, 500) : 0);
  const int n = static_cast<int>(2 * reach / spacing);
  const auto open_ground = [&](float x, float y) {
    const Streets& s = layout.streets;
    const float u = s.u_of(x, y), v = s.v_of(x, y);
    const auto iu = std::upper_bound(s.u_lines.begin(), s.u_lines.end(), u) - s.u_lines.begin() - 1;
    const auto iv = std::upper_bound(s.v_lines.begin(), s.v_lines.end(), v) - s.v_lines.begin() - 1;
    const auto U = static_cast<Index>(s.u_lines.size()) - 1,
               V = static_cast<Index>(s.v_lines.size()) - 1;
    if (iu < 0 || iu >= U || iv < 0 || iv >= V) return false;
    const Block& b = layout.blocks[static_cast<std::size_t>(iv * U + iu)];
    if (u < b.u0 || u > b.u1 || v < b.v0 || v > b.v1) return false;
    return b.ground == Ground::wild || b.ground == Ground::lawn || b.ground == Ground::bare;
  };
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) {
      const float x = -reach + spacing * (static_cast<float>(j) + draw(r, 0, 1));
      const float y = -reach + spacing * (static_cast<float>(i) + draw(r, 0, 1));
      // On wild ground many small ones and few large: shrubs among trees.
      const float spread = draw(r, 0, 1), tone = draw(r, 0.55, 1.4) * (wild ? 1.5f : 1.0f),
                  tall = draw(r, 1.2, 2.4);
      const float size = wild ? 0.25f + 0.95f * spread * spread : 0.45f + 0.7f * spread;
      const float lone = draw(r, 0, 1);
      float clump = 0;
      for (const auto& w : waves) clump += std::sin(w[0] * x + w[1] * y + w[2]);
      // A sum of six waves has deviation 1.73: the threshold gives about the wanted share.
      const bool inside = clump > 4.0f * (0.5f - density);
      if (lone > (inside ? 0.85f : wild ? 0.05f : 0.0f) || !open_ground(x, y)) continue;
      if (!layout.shore.empty() && layout.at(layout.shore, x, y) < 2) continue;
      if (!layout.lane.empty() &&
          std::abs(layout.at(layout.lane, x, y)) < layout.lane_half_width + size * radius) {
        continue;
      }
      const auto seed = static_cast<std::uint32_t>(r.next_u64()) & ~1u;
      Tree t{x,
             y,
             size * radius,
             std::min(size * radius * tall * (conifers ? 1.8f : 1.0f), 22.0f),
             layout.at(layout.terrain, x, y),
             {0.044f * tone, 0.060f * tone, 0.033f * tone},
             seed | (conifers ? 1u : 0u)};
      if (wild && ((seed >> 8) & 1023u) < boulders) {
        t.material = Material::rock;
        t.height = t.radius * (0.4f + 0.4f * tone);
        t.colour = {0.27f * tone, 0.26f * tone, 0.24f * tone};
        t.seed &= ~1u;
      }
      layout.trees.push_back(t);
    }
  }
}

}  // namespace satsurf::scene::simulate

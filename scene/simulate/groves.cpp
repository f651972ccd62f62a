// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/simulate/dress.h"
#include "satsurf/scene/simulate/noise.h"

#include <algorithm>
#include <cmath>

namespace satsurf::scene::simulate {

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
      t.deciduous = !conifers && unit(hash(0, 0, seed)) < layout.deciduous;
      layout.trees.push_back(t);
    }
  }
}

}  // namespace satsurf::scene::simulate

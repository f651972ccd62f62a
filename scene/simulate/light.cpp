// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/parallel.h"
#include "satsurf/scene/simulate/noise.h"
#include "satsurf/scene/simulate/render.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace satsurf::scene::simulate {
namespace {

constexpr float kNoShade = -1e9f;
constexpr double kRadians = std::numbers::pi / 180;
constexpr float kBareBelow = 0.6f;  // leaves, below which a crown lets the sun through

// Height of the shadow over every cell. Lines of cells along the sun's azimuth partition the grid
// (each column, or row, of the major direction is shifted by a rounded amount), and each line is
// swept once away from the sun:
//   shade(cell) = max(z, shade)(cell before) - distance tan(elevation)
Tensor cast_shadows(const HeightField& field, const std::array<float, 3>& to_sun) {
  const Index N = field.z.dim(0), M = field.z.dim(1);
  Tensor shade({N, M}, kNoShade);
  const float horizontal = std::hypot(to_sun[0], to_sun[1]);
  if (horizontal < 1e-4f) return shade;
  const double away_x = static_cast<double>(-to_sun[0] / horizontal),
               away_i = static_cast<double>(to_sun[1] / horizontal);
  const bool by_rows = std::abs(away_i) > std::abs(away_x);
  const double major = by_rows ? away_i : away_x, minor = by_rows ? away_x : away_i;
  const Index length = by_rows ? N : M, width = by_rows ? M : N;
  const double slope = minor / std::abs(major);
  const auto drop = static_cast<float>(field.step / std::abs(major) *
                                       static_cast<double>(to_sun[2] / horizontal));
  std::vector<Index> shift(static_cast<std::size_t>(length));
  for (Index k = 0; k < length; ++k) {
    shift[static_cast<std::size_t>(k)] =
        static_cast<Index>(std::floor(static_cast<double>(k) * slope + 0.5));
  }
  const Index spread = std::abs(shift.back()), lines = width + spread;
  // line L passes minor coordinate L + first + shift[k]
  const Index first = slope > 0 ? -spread : 0;
  const Index major_stride = by_rows ? M : 1, minor_stride = by_rows ? 1 : M;
  for_range(lines, 64, [&](Index begin, Index end) {
    std::vector<float> edge(static_cast<std::size_t>(end - begin), kNoShade);
    for (Index k = 0; k < length; ++k) {
      const Index at = major > 0 ? k : length - 1 - k,
                  offset = first + shift[static_cast<std::size_t>(k)];
      const Index from = std::max(begin, -offset), to = std::min(end, width - offset);
      for (Index line = from; line < to; ++line) {
        float& e = edge[static_cast<std::size_t>(line - begin)];
        const Index cell = at * major_stride + (line + offset) * minor_stride;
        const float s = e - drop;
        shade[cell] = s;
        e = std::max(s, field.z[cell]);
      }
    }
  });
  return shade;
}

// Raises the cars of one date out of the ground, or of the deck they stand on.
void park_visitors(const City& city, LitCity& lit) {
  const Index N = city.field.z.dim(0);
  const auto step = static_cast<float>(city.field.step), half = 0.5f * step * static_cast<float>(N);
  lit.visitors.assign(static_cast<std::size_t>(N * N), 0);
  const auto& bare = city.floor.empty() ? city.cells : city.floor;
  const Tensor& ground = city.floor.empty() ? city.field.z : city.floor_z;
  const std::size_t count = std::min<std::size_t>(city.visitors.size(), 65000);
  for (std::size_t n = 0; n < count; ++n) {
    const std::uint32_t h = hash(static_cast<std::int32_t>(n), 77, lit.light.seed);
    if (static_cast<double>(unit(h)) >= lit.light.visitors) continue;
    const Car& c = city.visitors[n];
    const float a = 0.5f * c.length, b = 0.5f * c.width, r = a + b;
    const auto clamped = [&](float t) {
      return std::clamp(static_cast<Index>(std::floor(t / step)), Index{0}, N - 1);
    };
    for (Index i = clamped(half - c.y - r); i <= clamped(half - c.y + r); ++i) {
      for (Index j = clamped(c.x - r + half); j <= clamped(c.x + r + half); ++j) {
        const float px = (static_cast<float>(j) + 0.5f) * step - half - c.x,
                    py = half - (static_cast<float>(i) + 0.5f) * step - c.y;
        const float along = px * c.cos + py * c.sin, across = py * c.cos - px * c.sin;
        if (std::abs(along) > a || std::abs(across) > b) continue;
        const Index k = i * N + j;
        const Material m = bare[static_cast<std::size_t>(k)].material;
        if ((m == Material::roof) != c.deck || m == Material::car || m == Material::water) continue;
        const float z = ground[k] + (c.tall < 2 && std::abs(along) > 0.6f * a ? 0.65f : 1) * c.tall;
        if (!city.floor.empty()) lit.floor.z[k] = std::max(lit.floor.z[k], z);
        if (z <= lit.field.z[k]) continue;
        lit.field.z[k] = z;
        lit.visitors[static_cast<std::size_t>(k)] = static_cast<std::uint16_t>(n + 1);
      }
    }
  }
}

}  // namespace

LitCity light_city(const City& city, const Daylight& light) {
  LitCity lit;
  lit.light = light;
  const double e = light.sun.elevation_deg * kRadians, a = light.sun.azimuth_deg * kRadians;
  lit.to_sun = {static_cast<float>(std::cos(e) * std::sin(a)),
                static_cast<float>(std::cos(e) * std::cos(a)), static_cast<float>(std::sin(e))};
  lit.field = city.field;
  lit.field.z = city.field.z.clone();
  const bool trees = !city.floor.empty();
  if (trees) {
    lit.floor = city.field;
    lit.floor.z = city.floor_z.clone();
  }
  park_visitors(city, lit);
  lit.columns.emplace(lit.field);
  if (trees) lit.floor_columns.emplace(lit.floor);
  lit.shade = cast_shadows(lit.field, lit.to_sun);
  if (trees && light.leaves < kBareBelow) {
    HeightField sparse = lit.field;
    sparse.z = lit.field.z.clone();
    for_range(sparse.z.dim(0), 32, [&](Index begin, Index end) {
      const Index N = sparse.z.dim(1);
      for (Index k = begin * N; k < end * N; ++k) {
        const SurfaceCell& cell = city.cells[static_cast<std::size_t>(k)];
        if (cell.material == Material::tree && (cell.plant & 128u) != 0)
          sparse.z[k] = lit.floor.z[k];
      }
    });
    lit.sparse_shade = cast_shadows(sparse, lit.to_sun);
  }
  return lit;
}

}  // namespace satsurf::scene::simulate

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/simulate/render.h"

#include "satsurf/core/parallel.h"
#include "satsurf/scene/simulate/noise.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace satsurf::scene::simulate {
namespace {

constexpr float kNoShade = -1e9f;
constexpr std::uint8_t kCarShadow = 255;
constexpr double kRadians = std::numbers::pi / 180;

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

constexpr std::array<Colour, 6> kCarColours{{{0.72f, 0.72f, 0.72f},
                                             {0.03f, 0.03f, 0.035f},
                                             {0.35f, 0.36f, 0.38f},
                                             {0.26f, 0.06f, 0.05f},
                                             {0.07f, 0.09f, 0.16f},
                                             {0.30f, 0.26f, 0.16f}}};

// Cars of one date are painted flat: a car and, beside it away from the sun, its shadow.
void park_visitors(const City& city, LitCity& lit) {
  const Index N = city.field.z.dim(0);
  const auto step = static_cast<float>(city.field.step), half = 0.5f * step * static_cast<float>(N);
  lit.visitors.assign(static_cast<std::size_t>(N * N), 0);
  const float reach = 1.4f / std::max(0.3f, lit.to_sun[2]);
  const auto paint = [&](const Car& c, float dx, float dy, std::uint8_t value) {
    const float a = 0.5f * c.length, b = 0.9f, r = a + b;
    const float x = c.x + dx, y = c.y + dy;
    const auto clamped = [&](float t) {
      return std::clamp(static_cast<Index>(std::floor(t / step)), Index{0}, N - 1);
    };
    for (Index i = clamped(half - y - r); i <= clamped(half - y + r); ++i) {
      for (Index j = clamped(x - r + half); j <= clamped(x + r + half); ++j) {
        const float px = (static_cast<float>(j) + 0.5f) * step - half - x,
                    py = half - (static_cast<float>(i) + 0.5f) * step - y;
        const float along = px * c.cos + py * c.sin, across = py * c.cos - px * c.sin;
        if (std::abs(along) > a || std::abs(across) > b) continue;
        const Material m = city.cell(i, j).material;
        if (m == Material::roof || m == Material::tree || m == Material::car ||
            m == Material::water)
          continue;
        std::uint8_t& cell = lit.visitors[static_cast<std::size_t>(i * N + j)];
        const bool glass = std::abs(along) > 0.35f * a && std::abs(along) < 0.6f * a;
        if (value != kCarShadow)
          cell = glass ? 2 : value;
        else if (cell == 0)
          cell = value;
      }
    }
  };
  for (const bool shadows : {false, true}) {
    for (std::size_t k = 0; k < city.visitors.size(); ++k) {
      const std::uint32_t h = hash(static_cast<std::int32_t>(k), 77, lit.light.seed);
      if (static_cast<double>(unit(h)) >= lit.light.visitors) continue;
      const Car& c = city.visitors[k];
      if (shadows) {
        paint(c, -0.6f * reach * lit.to_sun[0], -0.6f * reach * lit.to_sun[1], kCarShadow);
      } else {
        paint(c, 0, 0, static_cast<std::uint8_t>(1 + (h & 0xFFu) % kCarColours.size()));
      }
    }
  }
}

class Shader {
 public:
  Shader(const City& city, const LitCity& lit, std::uint32_t waves)
      : city_(city), lit_(lit), cols_(city.field.z.dim(1)), waves_(waves) {}

  // Radiance of what a ray meets at (x, y) local, m.
  Colour operator()(const ColumnField::Hit& hit, double x, double y) const {
    if (hit.row < 0) return {0, 0, 0};
    const Index k = hit.row * cols_ + hit.col;
    const SurfaceCell& cell = city_.cells[static_cast<std::size_t>(k)];
    const float top = city_.field.z[k];
    if (hit.side && cell.part != 0 &&
        top - city_.field.z[hit.front_row * cols_ + hit.front_col] > 0.8f) {
      return wall(hit, cell, x, y);
    }
    Colour albedo;
    for (std::size_t b = 0; b < 3; ++b)
      albedo[b] = static_cast<float>(cell.albedo[b]) * (1.0f / 65535.0f);
    const Daylight& d = lit_.light;
    float open = 1;
    const std::uint8_t visitor = lit_.visitors[static_cast<std::size_t>(k)];
    if (visitor == kCarShadow) {
      open = 0.15f;
    } else if (visitor != 0) {
      albedo = kCarColours[static_cast<std::size_t>(visitor - 1)];
    } else {
      switch (cell.material) {
        case Material::grass:
        case Material::tree:
        case Material::field:
          for (std::size_t b = 0; b < 3; ++b) albedo[b] *= d.vegetation[b];
          break;
        case Material::asphalt:
        case Material::soil:
          for (float& a : albedo) a *= d.wetness;
          break;
        case Material::water: {
          const std::uint32_t h = hash(static_cast<std::int32_t>(hit.row / 2),
                                       static_cast<std::int32_t>(hit.col / 3), d.seed ^ waves_);
          for (std::size_t b = 0; b < 3; ++b) albedo[b] = d.water[b] * (1 + d.ripples * bell(h));
          break;
        }
        default:
          break;
      }
    }
    // Side faces of crowns, kerbs and slopes are coloured as the column's top; what lies deep in a
    // crown is dimmer.
    float sky = static_cast<float>(cell.sky) * (1.0f / 255.0f), lit = open * lit_share(k, top);
    if (hit.side && cell.material == Material::tree) {
      const float depth = top - hit.z;
      sky *= 1 / (1 + 0.35f * depth);
      lit *= lit_share(hit.front_row * cols_ + hit.front_col, hit.z) / (1 + 0.15f * depth);
    }
    const float gx = static_cast<float>(cell.slope_x) * (1.0f / 4096.0f),
                gy = static_cast<float>(cell.slope_y) * (1.0f / 4096.0f);
    const float facing = (lit_.to_sun[2] - gx * lit_.to_sun[0] - gy * lit_.to_sun[1]) /
                         std::sqrt(1 + gx * gx + gy * gy);
    return shine(albedo, lit * std::max(0.0f, facing), sky);
  }

 private:
  // Shadow edges are as wide as a hand: the sun is no point, and cells have a size.
  float lit_share(Index cell, float z) const {
    return std::clamp((z - lit_.shade[cell]) * 6.0f + 0.5f, 0.0f, 1.0f);
  }

  Colour shine(const Colour& albedo, float sun, float sky) const {
    Colour out;
    for (std::size_t b = 0; b < 3; ++b)
      out[b] = albedo[b] * (lit_.light.sun_colour[b] * sun + lit_.light.sky_colour[b] * sky);
    return out;
  }

  Colour wall(const ColumnField::Hit& hit, const SurfaceCell& cell, double x, double y) const {
    const Part& p = city_.parts[static_cast<std::size_t>(cell.part - 1)];
    const float dx = static_cast<float>(x - city_.centre_x) - p.x,
                dy = static_cast<float>(y - city_.centre_y) - p.y;
    float along = dx * p.cos + dy * p.sin, across = dy * p.cos - dx * p.sin;
    float nu = 0, nv = 0, run;  // outward normal in the part's axes, distance along the wall
    if (p.round) {
      const float r = std::max(0.1f, std::hypot(along, across));
      nu = along / r;
      nv = across / r;
      run = p.a * std::atan2(across, along);
    } else if (p.a - std::abs(along) < p.b - std::abs(across)) {
      nu = along > 0 ? 1.0f : -1.0f;
      run = across + p.b;
    } else {
      nv = across > 0 ? 1.0f : -1.0f;
      run = along + p.a;
    }
    const float nx = nu * p.cos - nv * p.sin, ny = nu * p.sin + nv * p.cos;
    Colour albedo = p.wall_colour;
    const float up = hit.z - p.base;
    if (p.window_share > 0 && hit.z < p.eave - 0.4f) {
      const float storey = up / p.storey, bay = run / p.window_pitch;
      const float fy = storey - std::floor(storey), fx = bay - std::floor(bay);
      if (fy > 0.28f && fy < 0.28f + 0.6f * p.window_share + 0.15f &&
          (p.ribbon_windows || fx < p.window_share)) {
        const std::uint32_t h = hash(static_cast<std::int32_t>(std::floor(bay)),
                                     static_cast<std::int32_t>(std::floor(storey)), p.seed);
        const float glass = 0.05f + 0.10f * unit(h);
        albedo = {glass * 0.85f, glass * 0.95f, glass * 1.1f};
      }
    }
    const std::uint32_t h = hash(static_cast<std::int32_t>(std::floor(run * 3)),
                                 static_cast<std::int32_t>(std::floor(up * 3)), p.seed ^ 0xA5u);
    const float grain = 1 + 0.07f * bell(h);
    for (float& a : albedo) a *= grain;
    const float facing = nx * lit_.to_sun[0] + ny * lit_.to_sun[1];
    const Index front = hit.front_row * cols_ + hit.front_col;
    // A wall sees half the sky and, below it, sunlit ground that sends some light back.
    const float ground =
        static_cast<float>(city_.cells[static_cast<std::size_t>(front)].sky) * (1.0f / 255.0f);
    return shine(albedo, std::max(0.0f, facing) * lit_share(front, hit.z + 0.1f), ground * 0.62f);
  }

  const City& city_;
  const LitCity& lit_;
  Index cols_;
  std::uint32_t waves_;
};

}  // namespace

LitCity light_city(const City& city, const Daylight& light) {
  LitCity lit;
  lit.light = light;
  const double e = light.sun.elevation_deg * kRadians, a = light.sun.azimuth_deg * kRadians;
  lit.to_sun = {static_cast<float>(std::cos(e) * std::sin(a)),
                static_cast<float>(std::cos(e) * std::cos(a)), static_cast<float>(std::sin(e))};
  lit.shade = cast_shadows(city.field, lit.to_sun);
  park_visitors(city, lit);
  return lit;
}

Tensor render_view(const City& city, const ColumnField& columns, const LitCity& lit,
                   const Quadratic& local_from_pixel, Index height, Index width,
                   std::uint32_t waves) {
  auto out = Tensor::uninitialised({3, height, width});
  const Shader shader(city, lit, waves);
  const double high = columns.high(), low = columns.low(), drop = std::max(high - low, 1e-9);
  for_range(height, 4, [&](Index begin, Index end) {
    for (Index i = begin; i < end; ++i) {
      const auto y = static_cast<double>(i);
      // Within a pixel the map is as good as linear.
      const auto at_high = local_from_pixel.jacobian(0.5 * static_cast<double>(width), y, high);
      const auto at_low = local_from_pixel.jacobian(0.5 * static_cast<double>(width), y, low);
      for (Index j = 0; j < width; ++j) {
        const auto x = static_cast<double>(j);
        const auto top = local_from_pixel(x, y, high), bottom = local_from_pixel(x, y, low);
        Colour sum{0, 0, 0};
        for (const double dy : {-0.25, 0.25}) {
          for (const double dx : {-0.25, 0.25}) {
            const double xt = top[0] + at_high[0][0] * dx + at_high[0][1] * dy,
                         yt = top[1] + at_high[1][0] * dx + at_high[1][1] * dy;
            const double xb = bottom[0] + at_low[0][0] * dx + at_low[0][1] * dy,
                         yb = bottom[1] + at_low[1][0] * dx + at_low[1][1] * dy;
            const ColumnField::Hit hit = columns.walk(xt, yt, xb, yb);
            const double s = (high - static_cast<double>(hit.z)) / drop;
            const Colour c = shader(hit, xt + s * (xb - xt), yt + s * (yb - yt));
            for (std::size_t b = 0; b < 3; ++b) sum[b] += c[b];
          }
        }
        for (std::size_t b = 0; b < 3; ++b)
          out[(static_cast<Index>(b) * height + i) * width + j] = 0.25f * sum[b];
      }
    }
  });
  return out;
}

}  // namespace satsurf::scene::simulate

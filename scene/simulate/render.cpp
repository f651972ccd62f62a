// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/simulate/render.h"

#include "satsurf/core/parallel.h"
#include "satsurf/scene/simulate/noise.h"

#include <algorithm>
#include <cmath>

namespace satsurf::scene::simulate {
namespace {

constexpr Colour kGlass{0.04f, 0.045f, 0.05f}, kTwigs{0.105f, 0.09f, 0.078f},
    kSnow{0.78f, 0.8f, 0.83f};

constexpr std::array<Colour, 6> kCarColours{{{0.72f, 0.72f, 0.72f},
                                             {0.03f, 0.03f, 0.035f},
                                             {0.35f, 0.36f, 0.38f},
                                             {0.26f, 0.06f, 0.05f},
                                             {0.07f, 0.09f, 0.16f},
                                             {0.30f, 0.26f, 0.16f}}};
constexpr std::array<Colour, 5> kCrops{{{0.055f, 0.09f, 0.035f},    // young
                                        {0.11f, 0.13f, 0.05f},      // grown
                                        {0.28f, 0.23f, 0.13f},      // ripe
                                        {0.32f, 0.28f, 0.20f},      // stubble
                                        {0.17f, 0.135f, 0.105f}}};  // ploughed
constexpr std::array<Colour, 4> kAutumn{{{0.21f, 0.16f, 0.035f},
                                         {0.20f, 0.095f, 0.03f},
                                         {0.14f, 0.06f, 0.035f},
                                         {0.12f, 0.11f, 0.04f}}};

void mix(Colour& c, const Colour& with, float share) {
  for (std::size_t k = 0; k < 3; ++k) c[k] += share * (with[k] - c[k]);
}

float smooth_step(float low, float high, float t) {
  const float c = std::clamp((t - low) / (high - low), 0.0f, 1.0f);
  return c * c * (3.0f - 2.0f * c);
}

// The sun's light and the season's colours on what rays meet, with trees or without.
class Shader {
 public:
  Shader(const City& city, const LitCity& lit, std::uint32_t waves)
      : city_(city), lit_(lit), cols_(city.field.z.dim(1)), waves_(waves) {
    // Every date has its own gaps and patches: those of the city, moved.
    const auto N = static_cast<std::uint32_t>(cols_);
    drift_row_ = static_cast<Index>(hash(1, 0, lit.light.seed) % N);
    drift_col_ = static_cast<Index>(hash(2, 0, lit.light.seed) % N);
  }

  // Share of what lies below a crown that is seen through it.
  float gap(const ColumnField::Hit& hit) const {
    if (hit.row < 0 || city_.floor.empty()) return 0;
    const Index k = hit.row * cols_ + hit.col;
    const SurfaceCell& cell = city_.cells[static_cast<std::size_t>(k)];
    if (cell.material != Material::tree || lit_.visitors[static_cast<std::size_t>(k)] != 0)
      return 0;
    const float rim = static_cast<float>(cell.plant & 127u) * (1.0f / 127.0f),
                own = unit(hash(cell.plant >> 8, 5, lit_.light.seed)),
                noise = 0.01f * static_cast<float>(drifted(city_.fine, hit.row, hit.col));
    const float leafy = std::clamp(
        2.5f * (0.5f * (own - 0.5f) + 1.1f * (rim - 0.7f) + 0.9f * noise - 0.25f), 0.0f, 0.85f);
    const float bare = std::clamp(0.42f + 0.4f * rim + 0.3f * noise, 0.15f, 0.92f);
    return leafy + (1 - leaves_of(cell)) * std::max(0.0f, bare - leafy);
  }

  // Radiance of what a ray meets at (x, y) local, m.
  Colour operator()(const ColumnField::Hit& hit, double x, double y, bool below_trees) const {
    if (hit.row < 0) return {0, 0, 0};
    const Index k = hit.row * cols_ + hit.col;
    const auto at = static_cast<std::size_t>(k);
    const SurfaceCell& cell = below_trees ? city_.floor[at] : city_.cells[at];
    const Tensor& z = below_trees ? lit_.floor.z : lit_.field.z;
    const float top = z[k];
    const std::uint16_t visitor = lit_.visitors[at];
    if (hit.side && cell.part != 0 && visitor == 0 &&
        top - z[hit.front_row * cols_ + hit.front_col] > 0.8f) {
      return wall(hit, cell, x, y);
    }
    Colour albedo;
    for (std::size_t b = 0; b < 3; ++b)
      albedo[b] = static_cast<float>(cell.albedo[b]) * (1.0f / 65535.0f);
    if (visitor != 0)
      albedo = visitor_colour(visitor - 1u, x, y);
    else
      dress(albedo, cell, hit);
    // Side faces of crowns, kerbs and slopes are coloured as the column's top; what lies deep in a
    // crown is dimmer.
    float sky = static_cast<float>(cell.sky) * (1.0f / 255.0f), sun = lit_share(k, top);
    if (hit.side && cell.material == Material::tree) {
      const float depth = top - hit.z;
      sky *= 1 / (1 + 0.35f * depth);
      sun *= lit_share(hit.front_row * cols_ + hit.front_col, hit.z) / (1 + 0.15f * depth);
    }
    const float gx = static_cast<float>(cell.slope_x) * (1.0f / 4096.0f),
                gy = static_cast<float>(cell.slope_y) * (1.0f / 4096.0f);
    const float facing = (lit_.to_sun[2] - gx * lit_.to_sun[0] - gy * lit_.to_sun[1]) /
                         std::sqrt(1 + gx * gx + gy * gy);
    return shine(albedo, sun * std::max(0.0f, facing), sky);
  }

 private:
  int drifted(const std::vector<std::int8_t>& noise, Index row, Index col) const {
    Index i = row + drift_row_, j = col + drift_col_;
    if (i >= cols_) i -= cols_;
    if (j >= cols_) j -= cols_;
    return noise[static_cast<std::size_t>(i * cols_ + j)];
  }

  float leaves_of(const SurfaceCell& tree) const {
    const float leaves = lit_.light.leaves;
    if ((tree.plant & 128u) == 0 || leaves >= 1) return 1;
    // Some trees are early and some are late.
    return std::clamp(
        leaves + 0.5f * (unit(hash(tree.plant >> 8, 9, 0)) - 0.5f) * (1 - std::abs(2 * leaves - 1)),
        0.0f, 1.0f);
  }

  Colour visitor_colour(std::uint32_t number, double x, double y) const {
    const Car& c = city_.visitors[number];
    const float dx = static_cast<float>(x - city_.centre_x) - c.x,
                dy = static_cast<float>(y - city_.centre_y) - c.y;
    const float nose = std::abs(dx * c.cos + dy * c.sin) / (0.5f * c.length);
    if (c.tall >= 2) return c.colour;
    if (nose > 0.35f && nose < 0.6f) return kGlass;
    // Of the same stall, another car.
    return kCarColours[hash(static_cast<std::int32_t>(number), 3, lit_.light.seed) %
                       kCarColours.size()];
  }

  // What season and weather do to a surface.
  void dress(Colour& albedo, const SurfaceCell& cell, const ColumnField::Hit& hit) const {
    const Daylight& d = lit_.light;
    const auto scale = [&](float f) {
      for (float& a : albedo) a *= f;
    };
    float snow = 1;  // share of the snow that stays on it
    switch (cell.material) {
      case Material::tree: {
        for (std::size_t b = 0; b < 3; ++b) albedo[b] *= d.vegetation[b];
        const std::uint32_t h = hash(cell.plant >> 8, 6, d.seed);
        scale(0.82f + 0.36f * unit(h));
        snow = 0.3f;
        if ((cell.plant & 128u) == 0) break;
        const float light = (albedo[0] + albedo[1] + albedo[2]) * (1 / 0.15f);
        const auto tinted = [&](const Colour& c) {
          return Colour{light * c[0], light * c[1], light * c[2]};
        };
        if (d.autumn > 0)
          mix(albedo, tinted(kAutumn[(cell.plant >> 8) % kAutumn.size()]), d.autumn * unit(h));
        mix(albedo, tinted(kTwigs), 1 - leaves_of(cell));
        break;
      }
      case Material::field: {
        const float light = (albedo[0] + albedo[1] + albedo[2]) * (1 / 0.42f);
        const Colour& crop = kCrops[hash(cell.plant, 4, d.seed) % kCrops.size()];
        for (std::size_t b = 0; b < 3; ++b) albedo[b] = std::min(light, 1.6f) * crop[b];
        break;
      }
      case Material::grass:
        for (std::size_t b = 0; b < 3; ++b) albedo[b] *= d.vegetation[b];
        scale(0.8f + 0.4f * unit(hash(cell.plant, 8, d.seed)));
        break;
      case Material::asphalt:
      case Material::soil:
        scale(d.wetness);
        [[fallthrough]];
      case Material::concrete:
      case Material::roof:
        if (d.puddles > 0) {
          // Roofs drain better than the ground, but not evenly.
          const float wet =
              smooth_step(-10, 90, static_cast<float>(drifted(city_.patch, hit.row, hit.col)));
          scale(1 - (cell.material == Material::roof ? 0.4f : 1.0f) * d.puddles * wet);
        }
        break;
      case Material::water: {
        const std::uint32_t h = hash(static_cast<std::int32_t>(hit.row / 2),
                                     static_cast<std::int32_t>(hit.col / 3), d.seed ^ waves_);
        for (std::size_t b = 0; b < 3; ++b) albedo[b] = d.water[b] * (1 + d.ripples * bell(h));
        return;
      }
      case Material::car:
        return;
      case Material::rock:
        break;
    }
    if (d.snow <= 0) return;
    const auto noise = static_cast<float>(drifted(city_.patch, hit.row, hit.col)) +
                       0.4f * static_cast<float>(drifted(city_.fine, hit.row, hit.col));
    mix(albedo, kSnow, snow * smooth_step(-15, 15, noise + 160 * (d.snow - 0.5f)));
  }

  // Shadow edges are as wide as a hand: the sun is no point, and cells have a size. The twigs of
  // bare trees take half of it.
  float lit_share(Index cell, float z) const {
    const float all = std::clamp((z - lit_.shade[cell]) * 6.0f + 0.5f, 0.0f, 1.0f);
    if (lit_.sparse_shade.empty() || all == 1) return all;
    const float solid = std::clamp((z - lit_.sparse_shade[cell]) * 6.0f + 0.5f, 0.0f, 1.0f);
    return solid * (all + (1 - all) * 0.6f * (1 - lit_.light.leaves));
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
    if (p.free_form) {
      nu = static_cast<float>(hit.front_col - hit.col);
      nv = static_cast<float>(hit.row - hit.front_row);
      run = std::abs(nu) > std::abs(nv) ? dy : dx;
    } else if (p.round) {
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
    const float c = p.free_form ? 1.0f : p.cos, s = p.free_form ? 0.0f : p.sin;
    const float nx = nu * c - nv * s, ny = nu * s + nv * c;
    Colour albedo = p.wall_colour;
    const float up = hit.z - p.base;
    if (p.open && hit.z < p.eave - 0.7f) albedo = {0.02f, 0.02f, 0.02f};
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
  Index cols_, drift_row_ = 0, drift_col_ = 0;
  std::uint32_t waves_;
};

// A straight ray, given by where it is at the heights of one field, as a walk through another.
struct Ray {
  double x0, y0, x1, y1, high, drop;

  ColumnField::Hit walk(const ColumnField& columns) const {
    const double a = (high - columns.high()) / drop, b = (high - columns.low()) / drop;
    return columns.walk(x0 + a * (x1 - x0), y0 + a * (y1 - y0), x0 + b * (x1 - x0),
                        y0 + b * (y1 - y0));
  }
  std::array<double, 2> at(float z) const {
    const double s = (high - static_cast<double>(z)) / drop;
    return {x0 + s * (x1 - x0), y0 + s * (y1 - y0)};
  }
};

}  // namespace

Tensor render_view(const City& city, const LitCity& lit, const Quadratic& local_from_pixel,
                   Index height, Index width, std::uint32_t waves) {
  auto out = Tensor::uninitialised({3, height, width});
  const Shader shader(city, lit, waves);
  const ColumnField& columns = *lit.columns;
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
            const Ray ray{top[0] + at_high[0][0] * dx + at_high[0][1] * dy,
                          top[1] + at_high[1][0] * dx + at_high[1][1] * dy,
                          bottom[0] + at_low[0][0] * dx + at_low[0][1] * dy,
                          bottom[1] + at_low[1][0] * dx + at_low[1][1] * dy,
                          high,
                          drop};
            const ColumnField::Hit hit = columns.walk(ray.x0, ray.y0, ray.x1, ray.y1);
            const auto p = ray.at(hit.z);
            Colour c = shader(hit, p[0], p[1], false);
            if (const float gap = shader.gap(hit); gap > 0.02f) {
              const ColumnField::Hit below = ray.walk(*lit.floor_columns);
              const auto q = ray.at(below.z);
              mix(c, shader(below, q[0], q[1], true), gap);
            }
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

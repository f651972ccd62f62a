// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/simulate/city.h"

#include "satsurf/core/parallel.h"
#include "satsurf/scene/classes.h"
#include "satsurf/scene/simulate/layout.h"
#include "satsurf/scene/simulate/natural.h"
#include "satsurf/scene/simulate/noise.h"
#include "satsurf/scene/simulate/texture.h"

#include <algorithm>
#include <cmath>
#include <optional>

namespace satsurf::scene::simulate {
namespace {

constexpr Index kBand = 32;  // rows painted at a time

// Share of a cell that a line of the given half width covers, `d` from its axis.
float line_cover(float d, float half_width, float step) {
  return std::clamp((half_width - std::abs(d)) / step + 0.5f, 0.0f,
                    std::min(1.0f, 2 * half_width / step));
}

void mix(Colour& c, const Colour& with, float share) {
  for (std::size_t k = 0; k < 3; ++k) c[k] += share * (with[k] - c[k]);
}

class Painter {
 public:
  Painter(City& city, const Layout& layout, const Rng& rng)
      : city_(city),
        layout_(layout),
        N_(layout.plan.size),
        step_(static_cast<float>(layout.plan.step)),
        half_(layout.half_side()),
        seed_(static_cast<std::uint32_t>(rng.fork(1).next_u64())) {
    fine_ = noise(1.3, 2, 0.8f, 11);
    middle_ = noise(14, 3, 0.7f, 12);
    wide_ = noise(90, 2, 0.6f, 13);
    Rng r = rng.fork(2);
    rock_share_ = static_cast<float>(r.uniform(-0.3, 0.9));
    green_share_ = static_cast<float>(r.uniform(-0.4, 0.8));
    bumps_ = static_cast<float>(layout.plan.kind == SceneKind::rough ? r.uniform(0.05, 0.4)
                                                                     : r.uniform(0.0, 0.08));
    const float b = static_cast<float>(r.uniform(0.35, 1.2)), dry = static_cast<float>(r.uniform());
    wild_soil_ = {0.25f * b * static_cast<float>(r.uniform(0.95, 1.25)), 0.20f * b, 0.15f * b};
    wild_rock_ = {0.30f * b, 0.285f * b, 0.26f * b};
    wild_grass_ = {0.085f + 0.10f * dry, 0.10f + 0.075f * dry, 0.055f + 0.05f * dry};
    lane_colour_ =
        r.chance(0.4) ? Colour{0.13f, 0.13f, 0.132f}
                      : Colour{1.25f * wild_soil_[0], 1.25f * wild_soil_[1], 1.25f * wild_soil_[2]};
    if (layout.plan.dark) dark_.emplace(layout.plan, rng.fork(3));
  }

  void run() {
    city_.field.z = Tensor::uninitialised({N_, N_});
    city_.cells.resize(static_cast<std::size_t>(N_ * N_));
    city_.fine.resize(city_.cells.size());
    city_.patch.resize(city_.cells.size());
    const bool trees = !layout_.trees.empty();
    if (trees) {
      city_.floor.resize(city_.cells.size());
      city_.floor_z = Tensor::uninitialised({N_, N_});
    }
    for_range(N_, kBand, [&](Index begin, Index end) {
      for (Index i = begin; i < end; ++i) {
        for (Index j = 0; j < N_; ++j) {
          paint_ground(i, j);
          const Index k = i * N_ + j;
          const auto byte = [](float v) {
            return static_cast<std::int8_t>(std::clamp(100.0f * v, -127.0f, 127.0f));
          };
          city_.fine[static_cast<std::size_t>(k)] = byte(fine_[k]);
          city_.patch[static_cast<std::size_t>(k)] = byte(0.7f * middle_[k] + 0.7f * wide_[k]);
        }
      }
      for (std::size_t k = 0; k < city_.parts.size(); ++k) paint_part(k, begin, end);
      for (const Car& c : layout_.cars) paint_car(c, begin, end);
      if (!trees) return;
      const auto first = begin * N_, last = end * N_;
      std::copy(city_.cells.begin() + first, city_.cells.begin() + last,
                city_.floor.begin() + first);
      std::copy(city_.field.z.data() + first, city_.field.z.data() + last,
                city_.floor_z.data() + first);
      for (const Tree& t : layout_.trees) paint_tree(t, begin, end);
    });
    shape_cells(city_);
  }

 private:
  Tensor noise(double period, int octaves, float gain, std::uint64_t key) const {
    return fractal_noise(N_, N_, layout_.plan.step,
                         {.period = period,
                          .octaves = octaves,
                          .gain = gain,
                          .seed = hash(static_cast<std::int32_t>(key), 0, seed_)});
  }
  float x_of(Index j) const { return (static_cast<float>(j) + 0.5f) * step_ - half_; }
  float y_of(Index i) const { return half_ - (static_cast<float>(i) + 0.5f) * step_; }

  void put(Index i, Index j, float z, const Colour& c, Material m, std::uint16_t part,
           float extra = 0, std::uint16_t plant = 0, float uneven = 1) {
    const Index k = i * N_ + j;
    const Texture t = texture_of(m);
    const float grain =
        t.grain * bell(hash(static_cast<std::int32_t>(i), static_cast<std::int32_t>(j), seed_));
    const float f =
        1 + extra +
        uneven * (grain + t.fine * fine_[k] + t.middle * middle_[k] + t.wide * wide_[k]);
    SurfaceCell& cell = city_.cells[static_cast<std::size_t>(k)];
    Colour shown = c;
    if (dark_) {
      const float dark = dark_->factor(k, z, steepness(i, j), m);
      for (float& a : shown) a *= dark;
    }
    cell.set_albedo(shown, f);
    cell.material = m;
    cell.part = part;
    cell.plant = plant;
    city_.field.z[k] = z;
  }

  void paint_ground(Index i, Index j) {
    const Index k = i * N_ + j;
    const float x = x_of(j), y = y_of(i), z = layout_.terrain[k];
    if (!layout_.shore.empty() && layout_.shore[k] < 0) {
      return put(i, j, layout_.water_height, {0.03f, 0.045f, 0.05f}, Material::water, 0);
    }
    if (!layout_.lane.empty() && std::abs(layout_.lane[k]) < layout_.lane_half_width) {
      const float d = std::abs(layout_.lane[k]) - 0.45f * layout_.lane_half_width;
      return put(i, j, z, lane_colour_, Material::asphalt, 0, 0.12f * line_cover(d, 0.4f, step_));
    }
    const Streets& s = layout_.streets;
    const float u = s.u_of(x, y), v = s.v_of(x, y);
    const std::size_t iu = interval(s.u_lines, u), iv = interval(s.v_lines, v);
    const auto signed_distance = [](const std::vector<float>& lines, std::size_t n, float at) {
      return at - lines[n] < lines[n + 1] - at ? at - lines[n] : at - lines[n + 1];
    };
    const float du = signed_distance(s.u_lines, iu, u), dv = signed_distance(s.v_lines, iv, v);
    const float across = std::min(std::abs(du), std::abs(dv)),
                other = std::max(std::abs(du), std::abs(dv));
    if (across < s.half_width) {
      Colour c = s.colour;
      if (s.marked && other > s.half_width + 1) {
        const float along = std::abs(du) < std::abs(dv) ? v : u;
        const bool dash = along - 6 * std::floor(along / 6) < 3;
        if (dash) mix(c, {0.5f, 0.5f, 0.48f}, 0.8f * line_cover(across, 0.1f, step_));
        mix(c, {0.5f, 0.5f, 0.48f}, 0.6f * line_cover(across - s.half_width + 0.5f, 0.07f, step_));
        // Stop bars and crossings.
        if (other < s.half_width + 4.5f && other > s.half_width + 1.5f && s.half_width > 5) {
          const float bar = across / 1.2f - std::floor(across / 1.2f);
          if (bar < 0.5f) mix(c, {0.5f, 0.5f, 0.48f}, 0.55f);
        }
      }
      return put(i, j, z, c, Material::asphalt, 0);
    }
    if (across < s.half_width + s.pavement) {
      return put(i, j, z + 0.12f, {0.30f, 0.29f, 0.265f}, Material::concrete, 0);
    }
    const Block& b = layout_.blocks[iv * (s.u_lines.size() - 1) + iu];
    paint_block(i, j, z, u, v, b);
  }

  void paint_block(Index i, Index j, float z, float u, float v, const Block& b) {
    const Index k = i * N_ + j;
    const float along = b.rows_along_u ? u - b.u0 : v - b.v0,
                across = b.rows_along_u ? v - b.v0 : u - b.u0;
    const float length = b.rows_along_u ? b.u1 - b.u0 : b.v1 - b.v0,
                width = b.rows_along_u ? b.v1 - b.v0 : b.u1 - b.u0;
    switch (b.ground) {
      case Ground::paved: {
        // Yards: rectangular patches of different age and colour, some of them grass.
        const auto pu = static_cast<std::int32_t>(std::floor(u / 17)),
                   pv = static_cast<std::int32_t>(std::floor(v / 13));
        const std::uint32_t h = hash(pu, pv, b.seed);
        if ((h & 15u) == 0) return put(i, j, z, {0.085f, 0.11f, 0.05f}, Material::grass, 0);
        return put(i, j, z, b.colour, Material::concrete, 0, 0.22f * (unit(h) - 0.5f));
      }
      case Ground::parking: {
        Colour c = b.colour;
        // two stalls of 5.2 m and an aisle
        const float row = across - 3 - 16 * std::floor((across - 3) / 16);
        if (across > 3 && across - row + 13.5f < width && row < 10.6f && along > 3 &&
            along < length - 3) {
          const float stall = (along - 3) / b.row_period;
          const float d = (stall - std::round(stall)) * b.row_period;
          mix(c, {0.5f, 0.5f, 0.48f}, 0.75f * line_cover(d, 0.08f, step_));
          mix(c, {0.5f, 0.5f, 0.48f}, 0.75f * line_cover(row - 5.2f, 0.08f, step_));
        }
        return put(i, j, z, c, Material::asphalt, 0);
      }
      case Ground::lawn: {
        const float bare = middle_[k] + 0.7f * wide_[k] - 0.75f;
        Colour c = b.colour;
        if (bare > 0) mix(c, wild_soil_, std::min(1.0f, 2.5f * bare));
        return put(i, j, z + 0.06f * fine_[k], c, Material::grass, 0, 0,
                   static_cast<std::uint16_t>(b.seed));
      }
      case Ground::bare:
        return put(i, j, z + 0.10f * middle_[k] + 0.04f * fine_[k], b.colour, Material::soil, 0);
      case Ground::crop: {
        const float row = across / b.row_period, wave = std::sin(6.2832f * row);
        const float height = b.colour[1] > b.colour[0] * 0.95f ? 0.5f : 0.12f;
        return put(i, j, z + 0.5f * height * wave, b.colour, Material::field, 0, 0.16f * wave,
                   static_cast<std::uint16_t>(b.seed));
      }
      case Ground::wild:
        break;
    }
    const float rock = middle_[k] + 0.8f * wide_[k] + 0.5f * fine_[k] +
                       1.2f * (steepness(i, j) - 0.45f) - rock_share_;
    const float green = 0.8f * middle_[k] + wide_[k] - 0.3f * fine_[k] - green_share_;
    Colour c = wild_soil_;
    mix(c, wild_grass_, std::clamp(3 * green + 0.5f, 0.0f, 1.0f));
    const float stone = std::clamp(3 * rock, 0.0f, 1.0f);
    mix(c, wild_rock_, stone);
    put(i, j, z + bumps_ * (fine_[k] + 0.6f * middle_[k]) * (0.4f + stone), c,
        stone > 0.5f ? Material::rock
        : green > 0  ? Material::grass
                     : Material::soil,
        0);
  }

  float steepness(Index i, Index j) const {
    const Index up = std::max(i - 2, Index{0}), down = std::min(i + 2, N_ - 1);
    const Index left = std::max(j - 2, Index{0}), right = std::min(j + 2, N_ - 1);
    const float gx = layout_.terrain[i * N_ + right] - layout_.terrain[i * N_ + left];
    const float gy = layout_.terrain[up * N_ + j] - layout_.terrain[down * N_ + j];
    return std::sqrt(gx * gx + gy * gy) / (4 * step_);
  }

  static std::size_t interval(const std::vector<float>& lines, float at) {
    const auto it = std::upper_bound(lines.begin() + 1, lines.end() - 1, at);
    return static_cast<std::size_t>(it - lines.begin()) - 1;
  }

  // Calls body(i, j, along, across) for the cells of a band within an upright rectangle around (x,
  // y).
  template <class Body>
  void for_footprint(float x, float y, float c, float s, float a, float b, Index begin, Index end,
                     const Body& body) {
    const float rx = std::abs(a * c) + std::abs(b * s), ry = std::abs(a * s) + std::abs(b * c);
    const Index i0 = std::max(begin, static_cast<Index>(std::floor((half_ - y - ry) / step_)));
    const Index i1 = std::min(end, static_cast<Index>(std::floor((half_ - y + ry) / step_)) + 1);
    const Index j0 = std::max(Index{0}, static_cast<Index>(std::floor((x - rx + half_) / step_)));
    const Index j1 = std::min(N_, static_cast<Index>(std::floor((x + rx + half_) / step_)) + 1);
    for (Index i = i0; i < i1; ++i) {
      const float dy = y_of(i) - y;
      for (Index j = j0; j < j1; ++j) {
        const float dx = x_of(j) - x, along = dx * c + dy * s, across = dy * c - dx * s;
        if (std::abs(along) <= a && std::abs(across) <= b) body(i, j, along, across);
      }
    }
  }

  static float roof_height(const Part& p, float along, float across) {
    const float to_long_edge = p.b - std::abs(across), to_short_edge = p.a - std::abs(along);
    switch (p.roof) {
      case Roof::flat: {
        const float q = (along * along) / (p.a * p.a) + (across * across) / (p.b * p.b);
        const float edge =
            p.round ? (1 - std::sqrt(q)) * p.a : std::min(to_long_edge, to_short_edge);
        return edge < 0.45f ? p.rise : 0.0f;
      }
      case Roof::gable:
        return p.rise * to_long_edge / p.b;
      case Roof::hip:
        return p.rise * std::min(to_long_edge, to_short_edge) / std::min(p.a, p.b);
      case Roof::shed:
        return p.rise * 0.5f * (across / p.b + 1);
      case Roof::barrel:
        return p.rise * std::sqrt(std::max(0.0f, 1 - across * across / (p.b * p.b)));
      case Roof::sawtooth:
        return p.rise * (along / 7 - std::floor(along / 7));
    }
    return 0;
  }

  // Relative change of a roof's reflectance by its covering.
  float roof_pattern(const Part& p, float along, float across, Index i, Index j) const {
    const auto wrap = [](float t) { return t - std::floor(t); };
    switch (p.pattern) {
      case RoofPattern::plain:
        return 0;
      case RoofPattern::gravel: {
        return 0.10f *
                   bell(hash(static_cast<std::int32_t>(i), static_cast<std::int32_t>(j), p.seed)) +
               0.08f * fine_[i * N_ + j];
      }
      case RoofPattern::seams:
        return wrap(along / p.pattern_period) < 0.35f ? -0.12f : 0.05f;
      case RoofPattern::tiles: {
        const auto row = static_cast<std::int32_t>(std::floor(across / p.pattern_period));
        const auto col = static_cast<std::int32_t>(std::floor(along / p.pattern_period));
        return 0.16f * (unit(hash(col, row, p.seed)) - 0.5f) +
               (wrap(across / (2 * p.pattern_period)) < 0.5f ? -0.06f : 0.06f);
      }
      case RoofPattern::sheets: {
        const auto row = static_cast<std::int32_t>(std::floor(across / p.pattern_period));
        const auto col = static_cast<std::int32_t>(std::floor(along / (1.7f * p.pattern_period)));
        const float joint =
            std::min(std::abs(wrap(across / p.pattern_period + 0.5f) - 0.5f) * p.pattern_period,
                     std::abs(wrap(along / (1.7f * p.pattern_period) + 0.5f) - 0.5f) * 1.7f *
                         p.pattern_period);
        return 0.14f * (unit(hash(col, row, p.seed)) - 0.5f) -
               0.12f * line_cover(joint, 0.1f, step_);
      }
      case RoofPattern::panels: {  // rows of solar modules
        const float row = wrap(across / 3), col = wrap(along / 1.1f);
        return row < 0.65f ? (col < 0.1f ? -0.45f : -0.75f) : 0.05f;
      }
    }
    return 0;
  }

  void paint_part(std::size_t n, Index begin, Index end) {
    const Part& p = city_.parts[n];
    for_footprint(p.x, p.y, p.cos, p.sin, p.a, p.b, begin, end,
                  [&](Index i, Index j, float along, float across) {
                    if (p.round && along * along / (p.a * p.a) + across * across / (p.b * p.b) > 1)
                      return;
                    const float lift = roof_height(p, along, across), z = p.eave + lift;
                    if (z <= city_.field.z[i * N_ + j]) return;
                    const bool parapet = p.roof == Roof::flat && lift > 0;
                    put(i, j, z, parapet ? p.parapet_colour : p.roof_colour, Material::roof,
                        static_cast<std::uint16_t>(n + 1),
                        parapet ? 0.0f : roof_pattern(p, along, across, i, j), 0,
                        parapet ? 1.0f : p.texture);
                  });
  }

  // A crown is one dome or cone, or several around a large tree's trunk; it is ragged, and here and
  // there one sees the ground through it from straight above.
  void paint_tree(const Tree& t, Index begin, Index end) {
    const bool conifer = (t.seed & 1u) != 0, rock = t.material == Material::rock;
    struct Lobe {
      float x, y, inverse_r2, height;
    };
    std::array<Lobe, 4> lobes{{{0, 0, 1 / (t.radius * t.radius), 1}}};
    std::size_t count = 1;
    if (!rock && !conifer && t.radius > 2.2f) {
      for (; count < lobes.size(); ++count) {
        const std::uint32_t h = hash(static_cast<std::int32_t>(count), 31, t.seed);
        const float turn = 6.2832f * unit(h), away = 0.55f * t.radius,
                    r = t.radius * (0.4f + 0.35f * unit(hash(1, 0, h)));
        lobes[count] = {away * std::cos(turn), away * std::sin(turn), 1 / (r * r),
                        0.65f + 0.4f * unit(hash(2, 0, h))};
      }
      lobes[0].inverse_r2 *= 1.8f;
    }
    const float reach = 1.35f * t.radius;
    const auto number =
        static_cast<std::uint16_t>((t.seed >> 16 & 0xFFu) << 8 | (t.deciduous ? 128u : 0u));
    for_footprint(
        t.x, t.y, 1, 0, reach, reach, begin, end, [&](Index i, Index j, float dx, float dy) {
          const Index k = i * N_ + j;
          const SurfaceCell& under = city_.cells[static_cast<std::size_t>(k)];
          if (under.part != 0) return;  // trees next to a house are cut back
          // Crowns are ragged; the floor keeps large negative noise from turning them inside out.
          const float ragged = std::max(0.25f, 1 + 0.38f * fine_[k] + 0.40f * middle_[k]);
          float top = 0, rim = 1, lit = 0;
          for (std::size_t n = 0; n < count; ++n) {
            const Lobe& l = lobes[n];
            const float x = dx - l.x, y = dy - l.y, q = (x * x + y * y) * l.inverse_r2 * ragged;
            if (q >= 1) continue;
            const float dome = conifer ? 1 - std::sqrt(q) : std::sqrt(1 - q);
            const float height = l.height * (0.35f + 0.65f * dome);
            if (height > top) top = height, lit = dome;
            rim = std::min(rim, q);
          }
          if (top == 0) return;
          if (!rock && fine_[k] + 0.25f * rim > 1.05f) return;
          const float z = t.base + t.height * top * (1 + 0.06f * fine_[k]);
          if (z <= city_.field.z[k]) return;
          const auto edge = static_cast<std::uint16_t>(127.0f * rim);
          put(i, j, z, t.colour, t.material, 0, 0.35f * (lit - 0.6f),
              rock ? std::uint16_t{0} : static_cast<std::uint16_t>(number | edge));
        });
  }

  void paint_car(const Car& c, Index begin, Index end) {
    const float a = 0.5f * c.length, b = 0.5f * c.width;
    for_footprint(c.x, c.y, c.cos, c.sin, a, b, begin, end,
                  [&](Index i, Index j, float along, float) {
                    const Index k = i * N_ + j;
                    const SurfaceCell& under = city_.cells[static_cast<std::size_t>(k)];
                    if ((under.part != 0) != c.deck || under.material == Material::car) return;
                    const float nose = std::abs(along) / a;
                    const bool glass = c.tall < 2 && nose > 0.35f && nose < 0.6f;
                    const float tall = nose > 0.6f && c.tall < 2 ? 0.65f * c.tall : c.tall;
                    put(i, j, (c.deck ? city_.field.z[k] : layout_.terrain[k]) + tall,
                        glass ? Colour{0.04f, 0.045f, 0.05f} : c.colour, Material::car, 0);
                  });
  }

  City& city_;
  const Layout& layout_;
  Index N_;
  float step_, half_;
  std::uint32_t seed_;
  Tensor fine_, middle_, wide_;
  float rock_share_, green_share_, bumps_;
  Colour wild_soil_{}, wild_rock_{}, wild_grass_{}, lane_colour_{};
  std::optional<DarkGround> dark_;
};

}  // namespace

City make_city(const CityPlan& plan, const Rng& rng) {
  Layout layout;
  layout.plan = plan;
  shape_ground(layout, rng.fork(1));
  furnish(layout, rng.fork(2));
  if (layout.parts.size() > 65000) layout.parts.resize(65000);  // what SurfaceCell::part can number

  City city;
  city.field = {.z = {}, .x0 = plan.x0, .y0 = plan.y0, .step = plan.step};
  const double half = 0.5 * plan.step * static_cast<double>(plan.size);
  city.centre_x = plan.x0 + half;
  city.centre_y = plan.y0 - half;
  city.parts = std::move(layout.parts);
  city.visitors = std::move(layout.visitors);
  Painter(city, layout, rng.fork(3)).run();
  return city;
}

Tensor classes_of(const City& city) {
  auto out = Tensor::uninitialised(city.field.z.shape());
  for (Index k = 0; k < out.count(); ++k) {
    switch (city.cells[static_cast<std::size_t>(k)].material) {
      case Material::tree:
        out[k] = kTreeClass;
        break;
      case Material::roof:
        out[k] = kBuildingClass;
        break;
      case Material::water:
        out[k] = kWaterClass;
        break;
      default:
        out[k] = kGroundClass;
    }
  }
  return out;
}

}  // namespace satsurf::scene::simulate

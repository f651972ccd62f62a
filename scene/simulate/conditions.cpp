// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/simulate/conditions.h"

#include "satsurf/scene/simulate/draw.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace satsurf::scene::simulate {
namespace {

constexpr double kRadians = std::numbers::pi / 180;

// From 1 at midsummer to -1 at midwinter of a hemisphere, scaled down towards the equator.
double summer(double lat_deg, int day_of_year) {
  const double phase = std::cos(2 * std::numbers::pi * (day_of_year - 182) / 365.25);
  return (lat_deg < 0 ? -phase : phase) * std::clamp((std::abs(lat_deg) - 15) / 20, 0.0, 1.0);
}

}  // namespace

Daylight draw_daylight(const Sun& sun, double lat_deg, int day_of_year, Rng& rng) {
  Daylight d;
  d.sun = sun;
  const double height = std::sin(sun.elevation_deg * kRadians);
  const auto warm = static_cast<float>(0.16 * (1 - height));
  // A clear sky gives a twentieth of the sun's light, a hazy one a fifth, less under a low sun.
  const auto sky = static_cast<float>(log_uniform(rng, 0.05, 0.24) * (0.55 + 0.45 * height));
  d.sun_colour = {1.0f + warm, 0.98f, 0.93f - warm};
  d.sky_colour = {0.75f * sky, 1.0f * sky, 1.45f * sky};
  const float season = draw(rng, -1, 1), lush = draw(rng, 0.75, 1.35);
  d.vegetation = {lush * (1.0f + 0.3f * season), lush, lush * (1.0f - 0.1f * season)};
  // glint makes water bright on some dates
  const auto w = static_cast<float>(log_uniform(rng, 0.3, 6));
  const float green = draw(rng, 0.7, 1.4);
  d.water = {0.028f * w, 0.04f * w * green, 0.045f * w};
  d.ripples = draw(rng, 0.02, 0.25);
  d.wetness = rng.chance(0.15) ? draw(rng, 0.55, 0.9) : draw(rng, 0.9, 1.1);
  d.puddles = rng.chance(0.25) ? draw(rng, 0.15, 0.5) : 0.0f;
  d.visitors = rng.uniform(0.15, 0.8);
  // Leaves fall between summer and winter; in the tropics some trees are bare in the dry season.
  const double warmth = summer(lat_deg, day_of_year) + 0.15 * std::clamp(rng.normal(), -2.0, 2.0);
  d.leaves = static_cast<float>(std::clamp(0.5 + 1.6 * (warmth + 0.45), 0.0, 1.0));
  if (std::abs(lat_deg) < 20) d.leaves = rng.chance(0.1) ? draw(rng, 0.2, 1) : 1.0f;
  d.autumn = warmth > -0.75 && warmth < 0.1 && rng.chance(0.5) ? draw(rng, 0.2, 1) : 0.0f;
  if (warmth < -0.6 && std::abs(lat_deg) > 33 && rng.chance(0.25)) d.snow = draw(rng, 0.1, 0.7);
  d.seed = static_cast<std::uint32_t>(rng.next_u64());
  return d;
}

Product draw_product(bool panchromatic, Rng& rng) {
  Product p;
  p.panchromatic = panchromatic;
  p.pan_sharpened = !panchromatic && rng.chance(0.75);
  p.sharpened = rng.chance(0.5);
  if (rng.chance(0.35)) p.block_quality = 80 + static_cast<int>(rng.below(18));
  return p;
}

Development draw_atmosphere(const Product& product, SceneKind kind, const Daylight& light,
                            Rng& rng) {
  Development how;
  how.panchromatic = product.panchromatic;
  const auto haze = static_cast<float>(log_uniform(rng, 0.003, 0.03));
  const float blue = draw(rng, 1.1, 1.5);
  how.haze = {haze / blue, haze, haze * blue};
  for (float& t : how.tint) t = draw(rng, 0.93, 1.08);
  how.dark = draw(rng, 0.02, 0.26);
  how.gamma = draw(rng, 1.0, 2.1);
  // The stretch is that of a whole strip: where nothing is bright little of a crop saturates.
  const bool built =
      kind == SceneKind::city || kind == SceneKind::industrial || kind == SceneKind::suburb;
  how.saturated =
      static_cast<float>(built ? log_uniform(rng, 0.002, 0.1) : log_uniform(rng, 0.0005, 0.02));
  how.bright = rng.chance(0.15) ? draw(rng, 0.8, 1.0) : draw(rng, 1.0, 1.1);
  const auto on_ground =
      static_cast<float>(std::sin(light.sun.elevation_deg * kRadians)) + light.sky_colour[1];
  how.most_dark = haze + 0.05f * on_ground;
  how.least_bright = haze + draw(rng, 0.2, 0.34) * on_ground;
  how.bloom = rng.chance(0.6) ? draw(rng, 0.05, 0.5) : 0.0f;
  return how;
}

void draw_instrument(const Product& product, Development& how, Rng& rng) {
  how.psf_sigma = draw(rng, 0.4, 0.7);
  how.smear = rng.chance(0.4) ? draw(rng, 0.3, 1.4) : 0.0f;
  how.noise = static_cast<float>(log_uniform(rng, 0.002, 0.02));
  how.pan_sharpened = product.pan_sharpened;
  how.colour_shift = {draw(rng, -0.6, 0.6), draw(rng, -0.6, 0.6)};
  how.halo = product.sharpened ? draw(rng, 0.2, 1.0) : 0.0f;
  how.block_quality = product.block_quality;
  how.seed = static_cast<std::uint32_t>(rng.next_u64());
}

}  // namespace satsurf::scene::simulate

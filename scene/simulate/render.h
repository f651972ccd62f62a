// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/quadratic.h"
#include "satsurf/scene/ray_walk.h"
#include "satsurf/scene/simulate/city.h"
#include "satsurf/scene/simulate/orbit.h"

#include <vector>

namespace satsurf::scene::simulate {

/// Light and season of one date.
struct Daylight {
  Sun sun;                            ///< azimuth against the grid's north
  Colour sun_colour{1, 0.97f, 0.9f};  ///< irradiance on a surface square to the sun
  Colour sky_colour{0.25f, 0.3f, 0.4f};
  Colour vegetation{1, 1, 1};          ///< factors on the reflectance of grass, trees and crops
  Colour water{0.03f, 0.045f, 0.05f};  ///< reflectance
  float ripples = 0.1f;                ///< relative deviation of the water's brightness
  float wetness = 1;                   ///< factor on bare ground and asphalt
  double visitors = 0.5;               ///< share of the cars of City::visitors that are there
  std::uint32_t seed = 0;
};

/// Where the sun reaches on one date, and the cars that were there: shared by all views of that
/// date.
struct LitCity {
  Daylight light;
  std::array<float, 3> to_sun;  ///< unit vector, local
  Tensor shade;  ///< [H W] height of the shadow above every cell, m; -1e9 where there is none
  /// Per cell: 0, or 1 + colour of a car standing there, 255 in its shadow.
  std::vector<std::uint8_t> visitors;
};
/// Casts the shadows of one date.
LitCity light_city(const City& city, const Daylight& light);

/// Radiance of every pixel: 2 x 2 samples, each the surface its ray meets.
///   L = albedo (sun max(0, n.l) lit + sky visible)
/// columns           the city's field
/// lit               the same city on the view's date
/// local_from_pixel  localisation (x, y, z) -> local (x, y)
/// height, width     of the image, px
/// waves             seed of the ripples on the water, which no two views share
/// returns           [3 height width], linear
Tensor render_view(const City& city, const ColumnField& columns, const LitCity& lit,
                   const Quadratic& local_from_pixel, Index height, Index width,
                   std::uint32_t waves = 0);

/// What atmosphere, instrument and ground segment do to radiance.
struct Development {
  float haze = 0.02f;                 ///< airlight, radiance
  float psf_sigma = 0.5f;             ///< px
  float noise = 0.008f;               ///< deviation at full scale, as a share of it
  float dark = 0.05f, bright = 0.9f;  ///< where the 1 and 99 % quantiles are put
  float gamma = 1.8f;
  Colour tint{1, 1, 1};
  bool panchromatic = false;  ///< luminance in all three channels
  std::uint32_t seed = 0;
};
/// Radiance to an image of 256 levels.
/// radiance  [3 H W], linear
/// returns   [3 H W] in [0, 1]
Tensor develop(const Tensor& radiance, const Development& how);

}  // namespace satsurf::scene::simulate

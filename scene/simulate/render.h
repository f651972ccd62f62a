// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/quadratic.h"
#include "satsurf/scene/ray_walk.h"
#include "satsurf/scene/simulate/city.h"
#include "satsurf/scene/simulate/orbit.h"

#include <optional>
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
  float puddles = 0;                   ///< how much darker than the rest wet patches are
  float leaves = 1;                    ///< share of their leaves that deciduous trees have
  float autumn = 0;                    ///< how far those have turned
  float snow = 0;                      ///< share of the ground under snow
  double visitors = 0.5;               ///< share of City::visitors that are there
  std::uint32_t seed = 0;
};

/// The city of one date: its cars, and where the sun reaches. Shared by all views of that date.
struct LitCity {
  Daylight light;
  std::array<float, 3> to_sun;  ///< unit vector, local
  HeightField field, floor;     ///< with the cars of the date; with and without trees
  std::optional<ColumnField> columns, floor_columns;  ///< of those; no floor if there are no trees
  Tensor shade;  ///< [H W] height of the shadow above every cell, m; -1e9 where there is none
  /// [H W] the same without trees that are bare; empty where all have leaves.
  Tensor sparse_shade;
  /// Per cell: 0, or 1 + the number of the visitor standing there.
  std::vector<std::uint16_t> visitors;
};
/// Parks the cars and casts the shadows of one date.
LitCity light_city(const City& city, const Daylight& light);

/// Radiance of every pixel: 2 x 2 samples, each the surface its ray meets; where that is a crown
/// with gaps, or bare, mixed with what the ray meets below.
///   L = albedo (sun max(0, n.l) lit + sky visible)
/// lit               the city on the view's date
/// local_from_pixel  localisation (x, y, z) -> local (x, y)
/// height, width     of the image, px
/// waves             seed of the ripples on the water, which no two views share
/// returns           [3 height width], linear
Tensor render_view(const City& city, const LitCity& lit, const Quadratic& local_from_pixel,
                   Index height, Index width, std::uint32_t waves = 0);

}  // namespace satsurf::scene::simulate

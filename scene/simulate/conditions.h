// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/scene/simulate/develop.h"
#include "satsurf/scene/simulate/kind.h"
#include "satsurf/scene/simulate/render.h"

namespace satsurf::scene::simulate {

/// What the ground segment does with all images of a scene.
struct Product {
  bool panchromatic = false, pan_sharpened = false, sharpened = false;
  int block_quality = 0;  ///< as in Development
};

/// A day's light, season and weather.
/// sun          azimuth against the grid's north
/// day_of_year  from 1
Daylight draw_daylight(const Sun& sun, double lat_deg, int day_of_year, Rng& rng);

Product draw_product(bool panchromatic, Rng& rng);

/// Atmosphere, band gains and stretch of one date.
Development draw_atmosphere(const Product& product, SceneKind kind, const Daylight& light,
                            Rng& rng);
/// What differs between the views of a date: sharpness and noise.
void draw_instrument(const Product& product, Development& how, Rng& rng);

}  // namespace satsurf::scene::simulate

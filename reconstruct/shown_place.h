// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/shown_pixel.h"
#include "satsurf/nn/surfel_head.h"

#include <array>
#include <cmath>
#include <vector>

namespace satsurf::reconstruct {

/// Whether two images or more show a place, hidden or not; none shows an unknown height.
/// x, y, z  local m
inline bool shown_by_two(const std::vector<nn::PosedImage>& images, double x, double y, double z) {
  int showing = 0;
  for (const nn::PosedImage& image : images)
    if (std::isfinite(z) && nn::shown_pixel(image, image.pixel_from_local(x, y, z)) >= 0 &&
        ++showing == 2)
      return true;
  return false;
}

/// Whether two images or more show a place whose height is a guess: at that height, and also lower by
/// twice the expected error. The higher a place is taken to be, the further out images show it, so that
/// a guess that is too high would put a tower beyond the ground that they show.
/// x, y, z  local m
/// doubt    expected error of z as `nn::RefinedSurface` has it in `doubt`, m
inline bool shown_by_two_if_lower(const std::vector<nn::PosedImage>& images, double x, double y,
                                  double z, double doubt) {
  return shown_by_two(images, x, y, z) && shown_by_two(images, x, y, z - 2 * doubt);
}

/// Mean of the channels at the pixel of a place; NaN where there is none.
inline float shown_brightness(const nn::PosedImage& image, const std::array<double, 2>& place) {
  const Index at = nn::shown_pixel(image, place), C = image.rgb.dim(0), P = image.valid.count();
  if (at < 0) return NAN;
  float sum = 0;
  for (Index c = 0; c < C; ++c) sum += image.rgb[c * P + at];
  return sum / static_cast<float>(C);
}

/// Mean side of the images' pixels on the ground, m.
/// z  of the ground, local m
inline double mean_footprint(const std::vector<nn::PosedImage>& images, double z) {
  double sum = 0;
  for (const nn::PosedImage& image : images) sum += nn::pixel_geometry(image, z, 1).footprint;
  return sum / static_cast<double>(images.size());
}

}  // namespace satsurf::reconstruct

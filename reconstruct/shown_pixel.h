// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/whole.h"
#include "satsurf/nn/input.h"
#include "satsurf/nn/surfel_head.h"
#include "satsurf/rpc/model.h"

#include <array>
#include <cmath>
#include <vector>

namespace satsurf::reconstruct {

/// Index of the pixel that a place of an image lies in; -1 outside and where there is no image.
/// place  column and row
inline Index shown_pixel(const nn::PosedImage& image, const std::array<double, 2>& place) {
  const Index H = image.valid.dim(0), W = image.valid.dim(1);
  if (!rpc::inside_image({place[0], place[1]}, W, H)) return -1;
  const Index at = floored(place[1] + 0.5) * W + floored(place[0] + 0.5);
  return image.valid[at] > 0 ? at : -1;
}

/// Whether two images or more show a place, hidden or not; none shows an unknown height.
/// x, y, z  local m
inline bool shown_by_two(const std::vector<nn::PosedImage>& images, double x, double y, double z) {
  int showing = 0;
  for (const nn::PosedImage& image : images)
    if (std::isfinite(z) && shown_pixel(image, image.pixel_from_local(x, y, z)) >= 0 &&
        ++showing == 2)
      return true;
  return false;
}

/// Mean of the channels at that pixel; NaN where there is none.
inline float shown_brightness(const nn::PosedImage& image, const std::array<double, 2>& place) {
  const Index at = shown_pixel(image, place), C = image.rgb.dim(0), P = image.valid.count();
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

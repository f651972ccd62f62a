// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/whole.h"
#include "satsurf/nn/input.h"
#include "satsurf/rpc/model.h"

#include <array>

namespace satsurf::nn {

/// Index of the pixel that a place of an image lies in; -1 outside and where there is no image.
/// place  column and row
inline Index shown_pixel(const PosedImage& image, const std::array<double, 2>& place) {
  const Index H = image.valid.dim(0), W = image.valid.dim(1);
  if (!rpc::inside_image({place[0], place[1]}, W, H)) return -1;
  const Index at = floored(place[1] + 0.5) * W + floored(place[0] + 0.5);
  return image.valid[at] > 0 ? at : -1;
}

}  // namespace satsurf::nn

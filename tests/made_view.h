// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/scene/scene.h"

#include <string>

namespace satsurf::test {

/// A view of 100 x 100 pixels, north up, near 21 degrees east and 10 north, of ground at 20 m.
/// west  how far in the west the camera stands, m per metre of height
/// size  of a pixel, m
/// east  how far the middle lies in the east of the common one, m
inline scene::View view_from(const std::string& name, double west, double size = 0.5,
                             double east = 0) {
  constexpr double kPixels = 100, kMetresPerDegree = 110575, kMetresEast = 109640;
  scene::View v;
  v.name = name;
  v.rgb = Tensor({3, 100, 100}), v.valid = Tensor({100, 100}, 1.0F);
  v.rpc.samp_off = v.rpc.line_off = (kPixels - 1) / 2;
  v.rpc.samp_scale = v.rpc.line_scale = kPixels / 2;
  v.rpc.lon_off = 21 + east / kMetresEast, v.rpc.lat_off = 10;
  v.rpc.height_off = 20, v.rpc.height_scale = 100;
  v.rpc.lat_scale = kPixels / 2 * size / kMetresPerDegree;
  v.rpc.lon_scale = kPixels / 2 * size / kMetresEast;
  v.rpc.samp_num[1] = 1, v.rpc.line_num[2] = -1;
  v.rpc.samp_num[3] = west / size * v.rpc.height_scale / v.rpc.samp_scale;
  v.rpc.samp_den[0] = v.rpc.line_den[0] = 1;
  return v;
}

}  // namespace satsurf::test

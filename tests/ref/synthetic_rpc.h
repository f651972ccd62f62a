// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/rpc/model.h"

#include <cmath>

namespace satsurf::test {

/// A made-up camera of the general build of a vendor's: 0.5 m pixels seen `tilt` m of ground per
/// metre of height aside, 20000 px wide, with cubic terms and denominators of realistic size.
inline rpc::Rpc synthetic_rpc(double lon = 12.3, double lat = 45.1, double tilt_x = 0.3,
                              double tilt_y = -0.2) {
  rpc::Rpc r;
  r.line_off = 9999.5, r.samp_off = 10000.5, r.line_scale = 10000, r.samp_scale = 10001;
  r.lat_off = lat, r.lon_off = lon, r.height_off = 120;
  r.lat_scale = 0.045, r.lon_scale = 0.045 / std::cos(lat * 0.017453292519943295);
  r.height_scale = 500;
  // One unit of normalised height moves the image by 500 m x tilt / 0.5 m px, in units of the
  // scale.
  r.samp_num = {0.002, 0.998, 0.03, 0.1 * tilt_x, 2e-4, -3e-5, 1e-5, 4e-4, -2e-4, 3e-7};
  r.line_num = {-0.003, 0.028, -1.001, 0.1 * tilt_y, -3e-4, 2e-5, 4e-5, 1e-4, 3e-4, -2e-7};
  r.samp_den = {1, 3e-4, 5e-4, -2e-5, 1e-5, 0, 0, -2e-6, 3e-6, 0};
  r.line_den = {1, -2e-4, 4e-4, 1e-5, -1e-5, 0, 0, 1e-6, -4e-6, 0};
  for (std::size_t i = 10; i < 20; ++i) {
    const double s = i % 2 == 0 ? 1 : -1;
    r.samp_num[i] = s * 1e-6 * static_cast<double>(i - 8);
    r.line_num[i] = -s * 1e-6 * static_cast<double>(i - 7);
    r.samp_den[i] = s * 1e-8;
    r.line_den[i] = s * 2e-8;
  }
  return r;
}

}  // namespace satsurf::test

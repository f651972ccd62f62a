// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/view_geometry.h"

#include "satsurf/rpc/fit.h"

#include <cmath>
#include <numbers>
#include <utility>

namespace satsurf::scene {

Polygon footprint(const rpc::Rpc& rpc, Index width, Index height, const rpc::UtmZone& zone,
                  double h) {
  const double right = static_cast<double>(width) - 0.5, bottom = static_cast<double>(height) - 0.5;
  Polygon corners;
  for (const rpc::Pixel p :
       {rpc::Pixel{-0.5, -0.5}, {-0.5, bottom}, {right, bottom}, {right, -0.5}}) {
    const rpc::Geodetic g = rpc.localize(p, h);
    corners.push_back(rpc::utm_from_geodetic(zone, g.lon, g.lat));
  }
  return counter_clockwise(std::move(corners));
}

ViewAngles view_angles(const rpc::Rpc& rpc, Index width, Index height, double h) {
  constexpr double kDegree = 180 / std::numbers::pi;
  const rpc::Pixel centre{(static_cast<double>(width) - 1) / 2,
                          (static_cast<double>(height) - 1) / 2};
  const rpc::Geodetic g = rpc.localize(centre, h);
  rpc::LocalFrame frame;
  frame.zone = rpc::utm_zone_of(g.lon, g.lat);
  const rpc::ViewGeometry geometry =
      rpc::view_geometry(rpc::pixel_jacobian(rpc, frame, frame.local_from_geodetic(g)));
  const double east = geometry.direction[0], north = geometry.direction[1];
  const double azimuth = std::atan2(east, north) * kDegree;
  return {geometry.footprint, std::atan(std::hypot(east, north)) * kDegree,
          azimuth < 0 ? azimuth + 360 : azimuth};
}

double parallax(const rpc::Rpc& a, const rpc::Rpc& b, const rpc::Geodetic& p) {
  // along the ray of `a`:  d(pixel of b)/dh = J_(lon,lat) d(lon,lat)/dh + J_h
  const auto [lon_slope, lat_slope] = a.ray_slope(p);
  const auto [jx, jy] = b.jacobian(p);
  return std::hypot(jx[0] * lon_slope + jx[1] * lat_slope + jx[2],
                    jy[0] * lon_slope + jy[1] * lat_slope + jy[2]);
}

}  // namespace satsurf::scene

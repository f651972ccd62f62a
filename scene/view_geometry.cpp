// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/view_geometry.h"

#include "satsurf/rpc/fit.h"

#include <algorithm>
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

CommonGround common_ground(const rpc::Rpc& a, Index width_a, Index height_a, const rpc::Rpc& b,
                           Index width_b, Index height_b, double h) {
  constexpr double kOneZone = 3;  // degrees; further apart nothing can overlap
  const rpc::Geodetic p =
      a.localize({static_cast<double>(width_a) / 2, static_cast<double>(height_a) / 2}, h);
  const rpc::Geodetic q =
      b.localize({static_cast<double>(width_b) / 2, static_cast<double>(height_b) / 2}, h);
  CommonGround out{.zone = rpc::utm_zone_of(p.lon, p.lat), .both = {}};
  if (std::abs(std::remainder(p.lon - q.lon, 360)) >= kOneZone ||
      std::abs(p.lat - q.lat) >= kOneZone)
    return out;
  const Polygon of_a = footprint(a, width_a, height_a, out.zone, h),
                of_b = footprint(b, width_b, height_b, out.zone, h);
  out.both = intersect(of_a, of_b);
  if (!out.both.empty())
    out.share = polygon_area(out.both) / std::min(polygon_area(of_a), polygon_area(of_b));
  return out;
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

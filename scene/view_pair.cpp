// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/view_pair.h"

#include "satsurf/rpc/fit.h"
#include "satsurf/scene/view_geometry.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <numbers>
#include <string>

namespace satsurf::scene {
namespace {

/// Days since the year 0; nothing for a text that does not begin with a date.
std::optional<double> day_of(const std::string& date) {
  std::string digits;
  for (const char c : date)
    if (c >= '0' && c <= '9')
      digits += c;
    else if (c != '-' && c != '/' && c != ':')
      break;
  if (digits.size() < 8) return std::nullopt;
  const int year = std::atoi(digits.substr(0, 4).c_str()),
            month = std::atoi(digits.substr(4, 2).c_str()),
            day = std::atoi(digits.substr(6, 2).c_str());
  if (year < 1970 || year > 2100 || month < 1 || month > 12 || day < 1 || day > 31)
    return std::nullopt;
  return 365.25 * year + 30.4 * (month - 1) + day;
}

/// Metres east and north per metre of height along the ray through a point.
std::array<double, 2> ray_of(const View& view, const rpc::LocalFrame& frame,
                             const std::array<double, 3>& p_in_local) {
  const auto direction =
      rpc::view_geometry(rpc::pixel_jacobian(view.rpc, frame, p_in_local)).direction;
  return {direction[0], direction[1]};
}

}  // namespace

std::optional<double> suns_apart(const View& a, const View& b) {
  const auto direction = [](const View& v) -> std::array<double, 3> {
    constexpr double kRadians = std::numbers::pi / 180;
    const double up = v.sun_elevation_deg * kRadians, from_north = v.sun_azimuth_deg * kRadians;
    return {std::cos(up) * std::sin(from_north), std::cos(up) * std::cos(from_north), std::sin(up)};
  };
  for (const View* v : {&a, &b})
    if (v->sun_elevation_deg == 0 && v->sun_azimuth_deg == 0) return std::nullopt;
  const auto p = direction(a), q = direction(b);
  const double cosine = p[0] * q[0] + p[1] * q[1] + p[2] * q[2];
  return std::acos(std::clamp(cosine, -1.0, 1.0)) * 180 / std::numbers::pi;
}

std::optional<double> days_apart(const View& a, const View& b) {
  const auto p = day_of(a.date), q = day_of(b.date);
  if (!p || !q) return std::nullopt;
  return std::abs(*p - *q);
}

ViewPair view_pair(const View& a, const View& b, double h) {
  ViewPair out{.suns_deg = suns_apart(a, b), .days = days_apart(a, b)};
  const CommonGround ground =
      common_ground(a.rpc, a.width(), a.height(), b.rpc, b.width(), b.height(), h);
  if (ground.both.empty()) return out;
  const auto middle = polygon_centroid(ground.both);
  const auto lon_lat = rpc::geodetic_from_utm(ground.zone, middle[0], middle[1]);
  rpc::LocalFrame frame;
  frame.zone = ground.zone, frame.easting0 = middle[0], frame.northing0 = middle[1], frame.h0 = h;
  const auto p = ray_of(a, frame, {0, 0, 0}), q = ray_of(b, frame, {0, 0, 0});
  out.share = ground.share;
  out.parallax = parallax(a.rpc, b.rpc, {lon_lat[0], lon_lat[1], h});
  out.base = std::hypot(p[0] - q[0], p[1] - q[1]);
  return out;
}

}  // namespace satsurf::scene

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/rpc/model.h"

#include <array>
#include <string>

namespace satsurf::rpc {

/// One UTM zone on WGS84.
struct UtmZone {
  int number = 31;
  bool north = true;

  /// 32601..32660 or 32701..32760
  int epsg() const { return (north ? 32600 : 32700) + number; }
  friend bool operator==(const UtmZone&, const UtmZone&) = default;
};

/// The zone of a position by its longitude (no exceptions for Norway and Svalbard).
UtmZone utm_zone_of(double lon, double lat);
/// Easting and northing, m, to better than 1e-6 m within the zone and its neighbours (Krueger
/// series, order 6).
std::array<double, 2> utm_from_geodetic(const UtmZone& zone, double lon, double lat);
/// lon, lat in degrees.
std::array<double, 2> geodetic_from_utm(const UtmZone& zone, double easting, double northing);
/// Earth-centred, earth-fixed coordinates, m.
std::array<double, 3> ecef_from_geodetic(const Geodetic& p);
Geodetic geodetic_from_ecef(const std::array<double, 3>& p);

/// The scene's metric frame: x = easting - origin, y = northing - origin, z = h - origin, one zone
/// forced for the whole scene. Small enough for float32.
struct LocalFrame {
  UtmZone zone;
  double easting0 = 0, northing0 = 0, h0 = 0;

  std::array<double, 3> local_from_geodetic(const Geodetic& p) const;
  Geodetic geodetic_from_local(const std::array<double, 3>& p_in_local) const;
  friend bool operator==(const LocalFrame&, const LocalFrame&) = default;
};

}  // namespace satsurf::rpc

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/rpc/height_range.h"
#include "satsurf/rpc/model.h"

#include <array>
#include <optional>
#include <string>

namespace satsurf::rpc {

/// One UTM zone on WGS84.
struct UtmZone {
  int number = 31;
  bool north = true;

  /// 32601..32660 in the north, 32701..32760 in the south.
  int epsg() const { return (north ? 32600 : 32700) + number; }
  friend bool operator==(const UtmZone&, const UtmZone&) = default;
};

/// The zone that a code names, see `UtmZone::epsg`; nothing for the code of any other system.
std::optional<UtmZone> zone_of_epsg(int epsg);
/// The same for zones on ETRS89 (258xx) and NAD83 (269xx), too, which lie within two metres of those on
/// WGS 84.
std::optional<UtmZone> zone_near_epsg(int epsg);

/// The zone of a position by its longitude (no exceptions for Norway and Svalbard).
UtmZone utm_zone_of(double lon, double lat);
/// Easting and northing, m, to better than 1e-6 m within the zone and its neighbours.
/// zone      of the result, whether or not the position lies in it
/// lon, lat  degrees on WGS84
/// Source: Krueger 1912, series of order 6 (Karney 2011).
std::array<double, 2> utm_from_geodetic(const UtmZone& zone, double lon, double lat);
/// The inverse of `utm_from_geodetic`.
/// zone               of the coordinates
/// easting, northing  m
/// returns            lon, lat in degrees
std::array<double, 2> geodetic_from_utm(const UtmZone& zone, double easting, double northing);
/// Derivatives of `geodetic_from_utm`, [lon, lat][easting, northing], degrees per m.
std::array<std::array<double, 2>, 2> geodetic_from_utm_jacobian(const UtmZone& zone, double easting,
                                                                double northing);
/// Earth-centred, earth-fixed coordinates of a position, m.
std::array<double, 3> ecef_from_geodetic(const Geodetic& p);
/// The inverse of `ecef_from_geodetic`: the position of earth-centred, earth-fixed coordinates, m.
Geodetic geodetic_from_ecef(const std::array<double, 3>& p);

/// The scene's metric frame: x = easting - origin, y = northing - origin, z = h - origin, one zone
/// forced for the whole scene. Small enough for float32.
struct LocalFrame {
  UtmZone zone;
  double easting0 = 0, northing0 = 0, h0 = 0;

  /// x, y, z in m.
  std::array<double, 3> local_from_geodetic(const Geodetic& p) const;
  /// The inverse of `local_from_geodetic`.
  Geodetic geodetic_from_local(const std::array<double, 3>& p_in_local) const;
  /// A range of heights above the ellipsoid as local z.
  HeightRange z_from_heights(const HeightRange& height_range) const;
  /// A range of local z as heights above the ellipsoid.
  HeightRange heights_from_z(const HeightRange& z_range) const;
  friend bool operator==(const LocalFrame&, const LocalFrame&) = default;
};

/// Angle of the grid's north at a position, degrees clockwise from true north: an azimuth against
/// the grid is that against true north minus it.
double grid_convergence_deg(const LocalFrame& frame, const Geodetic& at);

/// Derivatives of a pixel by a point of a local frame, [x, y][x, y, z], px per m.
/// camera      of the image
/// frame       of the point
/// p_in_local  where, m
PixelJacobian pixel_jacobian(const Rpc& camera, const LocalFrame& frame,
                             const std::array<double, 3>& p_in_local);

}  // namespace satsurf::rpc

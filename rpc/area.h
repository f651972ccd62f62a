// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/tensor.h"
#include "satsurf/rpc/frame.h"
#include "satsurf/rpc/raster.h"

#include <array>
#include <filesystem>
#include <functional>
#include <vector>

namespace satsurf::rpc {

/// A part of the ground: closed rings of corners, easting and northing in m of one zone. A point
/// lies in it where an odd number of them surround it, so that rings in rings are holes.
struct Area {
  std::vector<std::vector<std::array<double, 2>>> rings;

  /// Where a parallel of the grid enters and leaves it, from west to east.
  std::vector<double> crossings(double northing) const;
  bool contains(double easting, double northing) const;
  /// [height width] 1 for the cells of a grid in its zone which have their middle in it, 0 for others.
  Tensor cells(const GeoGrid& grid, Index height, Index width) const;
  /// Least easting and northing, then the largest.
  std::array<double, 4> bounds() const;
};

/// The ground between two meridians and two parallels, with corners along its sides so that these
/// stay where they are in the zone.
/// box     west, south, east, north in degrees on WGS84; across the antimeridian the east is below the
///         west, as in 179.9, -17, -179.9, -16.8
/// throws  ConfigError for a box that is empty, wider than 10 degrees or not on the Earth
Area area_of_box(const std::array<double, 4>& box, const UtmZone& zone);

/// All polygons of a vector file (GeoJSON, GeoPackage, shapefile, KML, FlatGeobuf or another of GDAL's
/// formats that SATSURF_GDAL_DRIVERS in the environment names), whatever their reference system.
/// zone    of the result
/// poll    called now and then; what it throws ends the reading
/// throws  IoError for a file that is none, has no polygon, names no reference system, or has more than
///         100,000 features, 20,000 rings or 200,000 corners; for a GeoPackage with views
Area read_area(const std::filesystem::path& path, const UtmZone& zone,
               const std::function<void()>& poll = {});

}  // namespace satsurf::rpc

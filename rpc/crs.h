// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

namespace satsurf::rpc {

/// A reference system in the words of OGC's WKT 1, as files beside pictures have it.
/// throws  Error for a code GDAL does not know
std::string crs_wkt(int epsg);

/// A projected reference system in metres, without heights.
struct ProjectedCrs {
  std::string label;  ///< "EPSG:31370", or the system's name where no authority has numbered it
  int epsg = 0;       ///< 0 alike
  std::string wkt;
};

/// The system that a text names: a code (`EPSG:31370`), WKT or a string of PROJ. Neither a file nor a
/// network is asked.
/// throws  ConfigError for anything but a projected system in metres: an unknown code, degrees, feet,
///         a compound with heights
ProjectedCrs projected_crs(const std::string& text);

/// Refuses a system that is made for elsewhere: whose area of use ends more than two degrees from a
/// place. Systems that name no area are for everywhere.
/// lon, lat  degrees on WGS84
/// throws    ConfigError
void check_area_of_use(const ProjectedCrs& crs, double lon, double lat);

}  // namespace satsurf::rpc

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/products.h"

#include "satsurf/core/error.h"
#include "satsurf/core/version.h"

#include <cmath>
#include <cstdio>
#include <optional>

#include <fmt/format.h>

namespace satsurf::app {

std::vector<std::string> frame_comments(const rpc::LocalFrame& frame) {
  return place_comments("EPSG:" + std::to_string(frame.zone.epsg()),
                        {frame.easting0, frame.northing0, frame.h0}, "the WGS84 ellipsoid");
}

std::vector<std::string> place_comments(const std::string& crs, const std::array<double, 3>& origin,
                                        const std::string& heights) {
  return {std::string("satsurf ") + program_version(), "crs " + crs,
          fmt::format("origin {:.17g} {:.17g} {:.17g}", origin[0], origin[1], origin[2]),
          "x east, y north, z up in m from the origin: easting, northing, height" +
              (heights.empty() ? std::string() : " above " + heights)};
}

rpc::LocalFrame frame_from_comments(const std::vector<std::string>& comments,
                                    const std::string& where) {
  rpc::LocalFrame frame;
  int epsg = 0;
  bool has_origin = false;
  for (const std::string& line : comments) {
    int code = 0;
    double e = 0, n = 0, h = 0;
    if (std::sscanf(line.c_str(), "crs EPSG:%d", &code) == 1) epsg = code;
    if (std::sscanf(line.c_str(), "origin %lf %lf %lf", &e, &n, &h) == 3) {
      has_origin = std::isfinite(e) && std::isfinite(n) && std::isfinite(h);
      frame.easting0 = e, frame.northing0 = n, frame.h0 = h;
    }
  }
  const std::optional<rpc::UtmZone> zone = rpc::zone_of_epsg(epsg);
  if (!has_origin || !zone)
    throw IoError(
        where +
        ": no frame in the header, expected comment lines `crs EPSG:326xx` and `origin E N H`");
  frame.zone = *zone;
  return frame;
}

rpc::GeoGrid geo_grid(const scene::HeightField& grid, const rpc::LocalFrame& frame) {
  return {frame.zone.epsg(), grid.x0 + frame.easting0, grid.y0 + frame.northing0, grid.step};
}

rpc::GeoGrid geo_grid(const reconstruct::Grid& grid, const rpc::LocalFrame& frame, Index y0) {
  return {frame.zone.epsg(), grid.east + frame.easting0,
          grid.north + frame.northing0 - static_cast<double>(y0) * grid.step, grid.step};
}

rpc::GeoTags signed_tags(rpc::GeoTags tags) {
  tags.software = std::string("satsurf ") + program_version();
  return tags;
}

void write_field(const std::filesystem::path& path, const Tensor& values,
                 const scene::HeightField& grid, const rpc::LocalFrame& frame, double offset,
                 const rpc::GeoTags& tags) {
  Tensor out = values.clone();
  for (float& v : out.values()) v = static_cast<float>(static_cast<double>(v) + offset);
  rpc::write_geo_raster(path, out, geo_grid(grid, frame), signed_tags(tags));
}

}  // namespace satsurf::app

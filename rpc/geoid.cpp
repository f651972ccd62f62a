// SPDX-License-Identifier: Apache-2.0
#include "satsurf/rpc/geoid.h"

#include "satsurf/core/error.h"
#include "satsurf/rpc/gdal.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include <ogr_spatialref.h>

namespace satsurf::rpc {

std::optional<std::vector<double>> above_ellipsoid(
    const OGRSpatialReference& up, const std::vector<std::array<double, 2>>& lon_lat,
    double height) {
  OGRSpatialReference ground, from, to;
  if (ground.importFromEPSG(4326) != OGRERR_NONE ||
      from.SetCompoundCS("WGS 84 + heights", &ground, &up) != OGRERR_NONE ||
      to.importFromEPSG(4979) != OGRERR_NONE)
    throw IoError(std::string("PROJ: EPSG:4326, EPSG:4979 or their compound with ") + up.GetName() +
                  " is missing, expected its database");
  from.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
  to.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
  // Without this PROJ takes the geoid for the ellipsoid where it has no grid, and says nothing.
  OGRCoordinateTransformationOptions options;
  options.SetBallparkAllowed(false);
  const std::unique_ptr<OGRCoordinateTransformation> transform(
      OGRCreateCoordinateTransformation(&from, &to, options));
  std::vector<double> x, y, z(lon_lat.size(), height);
  for (const auto& [lon, lat] : lon_lat) x.push_back(lon), y.push_back(lat);
  std::vector<int> done(lon_lat.size(), 0);
  const bool all = transform && transform->Transform(static_cast<int>(x.size()), x.data(), y.data(),
                                                     z.data(), nullptr, done.data());
  if (!all || !std::ranges::all_of(done, [](int ok) { return ok != 0; }) ||
      !std::ranges::all_of(z, [](double v) { return std::isfinite(v); }))
    return std::nullopt;
  return z;
}

std::vector<double> geoid_heights(HeightDatum geoid,
                                  const std::vector<std::array<double, 2>>& lon_lat) {
  if (height_epsg(geoid) == 0)
    throw Error(std::string("geoid_heights: ") + datum_text(geoid) + ", expected a geoid");
  const GdalScope scope;
  OGRSpatialReference up;
  if (up.importFromEPSG(height_epsg(geoid)) != OGRERR_NONE)
    throw IoError("PROJ: EPSG:" + std::to_string(height_epsg(geoid)) +
                  " is missing, expected its database");
  auto heights = above_ellipsoid(up, lon_lat, 0);
  if (!heights)
    throw IoError(std::string("no heights of the ") + datum_text(geoid) +
                  ", expected its grid among PROJ's (egm96_15.gtx is in proj-data)");
  return std::move(*heights);
}

void refer_to_geoid(Tensor& heights, const GeoGrid& grid, HeightDatum geoid) {
  constexpr Index kCells = 64;
  const std::optional<UtmZone> zone = zone_of_epsg(grid.epsg);
  if (!zone)
    throw Error("refer_to_geoid: a grid in EPSG:" + std::to_string(grid.epsg) +
                ", expected a zone of UTM (EPSG:326xx or 327xx)");
  const Index H = heights.dim(0), W = heights.dim(1);
  const Index rows = (H - 1) / kCells + 2, columns = (W - 1) / kCells + 2;
  std::vector<std::array<double, 2>> knots;
  for (Index i = 0; i < rows; ++i)
    for (Index j = 0; j < columns; ++j)
      knots.push_back(
          geodetic_from_utm(*zone, grid.x0 + (static_cast<double>(j * kCells) + 0.5) * grid.step,
                            grid.y0 - (static_cast<double>(i * kCells) + 0.5) * grid.step));
  const std::vector<double> above = geoid_heights(geoid, knots);
  for (Index i = 0; i < H; ++i)
    for (Index j = 0; j < W; ++j) {
      const double v = static_cast<double>(i % kCells) / kCells,
                   u = static_cast<double>(j % kCells) / kCells;
      const double* knot = above.data() + i / kCells * columns + j / kCells;
      const double geoid_here = (1 - v) * ((1 - u) * knot[0] + u * knot[1]) +
                                v * ((1 - u) * knot[columns] + u * knot[columns + 1]);
      heights[i * W + j] = static_cast<float>(static_cast<double>(heights[i * W + j]) - geoid_here);
    }
}

}  // namespace satsurf::rpc

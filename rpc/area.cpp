// SPDX-License-Identifier: Apache-2.0
#include "satsurf/rpc/area.h"

#include "satsurf/rpc/drivers.h"
#include "satsurf/rpc/gdal.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <memory>

#include <ogrsf_frmts.h>

namespace satsurf::rpc {
namespace {

namespace fs = std::filesystem;

/// Vector formats that are read without being named by the user; the reasons are those of
/// `open_raster`.
std::vector<std::string> vector_drivers() {
  std::vector<std::string> names{"GeoJSON",    "GPKG", "ESRI Shapefile", "LIBKML", "KML",
                                 "FlatGeobuf", "GML"};
  std::ranges::copy(trusted_drivers(), std::back_inserter(names));
  return names;
}

void add_ring(Area& area, const OGRLinearRing* ring) {
  if (ring == nullptr || ring->getNumPoints() < 4) return;
  auto& corners = area.rings.emplace_back();
  for (int i = 0; i + 1 < ring->getNumPoints(); ++i)  // the last is the first once more
    corners.push_back({ring->getX(i), ring->getY(i)});
}

/// Adds the rings of a polygon or of many.
void add_rings(Area& area, const OGRGeometry& geometry) {
  const OGRwkbGeometryType type = wkbFlatten(geometry.getGeometryType());
  if (type == wkbPolygon) {
    const OGRPolygon* polygon = geometry.toPolygon();
    add_ring(area, polygon->getExteriorRing());
    for (int i = 0; i < polygon->getNumInteriorRings(); ++i)
      add_ring(area, polygon->getInteriorRing(i));
  } else if (OGR_GT_IsSubClassOf(type, wkbGeometryCollection)) {
    for (const OGRGeometry* part : *geometry.toGeometryCollection()) add_rings(area, *part);
  }
}

/// Adds the polygons of a geometry, however nested. What else it holds is no area.
void take_polygons(const OGRGeometry& geometry, OGRMultiPolygon& out) {
  const OGRwkbGeometryType type = wkbFlatten(geometry.getGeometryType());
  if (type == wkbPolygon)
    out.addGeometry(&geometry);
  else if (OGR_GT_IsSubClassOf(type, wkbGeometryCollection))
    for (const OGRGeometry* part : *geometry.toGeometryCollection()) take_polygons(*part, out);
}

/// Length of all rings, in the units of the coordinates; NaN if a corner is.
double perimeter(const OGRMultiPolygon& polygons) {
  double sum = 0;
  for (const OGRPolygon* polygon : polygons)
    for (const OGRLinearRing* ring : *polygon) sum += ring->get_Length();
  return sum;
}

/// throws  IoError for corners that lie nowhere
void check_corners(const fs::path& path, const OGRMultiPolygon& polygons, bool degrees) {
  if (std::isnan(perimeter(polygons)))
    throw IoError(path.string() + ": a corner is no number, expected " +
                  (degrees ? "degrees" : "metres"));
  OGREnvelope box;
  polygons.getEnvelope(&box);
  // longitudes are counted from -180 or from 0, and a side may cross where they begin
  const double most_x = degrees ? 540 : 1e8, most_y = degrees ? 90 : 1e8;
  if (box.MinX >= -most_x && box.MaxX <= most_x && box.MinY >= -most_y && box.MaxY <= most_y)
    return;
  std::ostringstream text;
  text << path.string() << ": corners from (" << box.MinX << ", " << box.MinY << ") to ("
       << box.MaxX << ", " << box.MaxY << "), expected "
       << (degrees ? "degrees" : "at most 1e8 m either way");
  throw IoError(text.str());
}

/// The polygons of all layers as one, so that those that overlap count once.
std::unique_ptr<OGRGeometry> polygons_of(const fs::path& path, GDALDataset& d,
                                         OGRSpatialReference& wanted) {
  OGRMultiPolygon all;
  for (OGRLayer* layer : d.GetLayers())
    for (auto& feature : *layer) {
      const OGRGeometry* geometry = feature->GetGeometryRef();
      if (geometry == nullptr) continue;
      std::unique_ptr<OGRGeometry> flat(geometry->getLinearGeometry());
      flat->flattenTo2D();
      OGRMultiPolygon polygons;
      take_polygons(*flat, polygons);
      if (polygons.IsEmpty()) continue;
      const OGRSpatialReference* crs = layer->GetSpatialRef();
      if (crs == nullptr)
        throw IoError(path.string() + ": the layer " + layer->GetName() +
                      " names no reference system, expected one (a .prj beside a shapefile)");
      OGRSpatialReference from(*crs);
      from.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
      polygons.assignSpatialReference(&from);
      check_corners(path, polygons, from.IsGeographic() != 0);
      // corners along long sides, which are straight where they were drawn and not in the zone; not
      // so many that sides around the Earth fill the memory, or that those of polygons which cross
      // each other take seconds to be joined
      constexpr double kMostCorners = 2e3;
      polygons.segmentize(
          std::max(from.IsGeographic() ? 0.001 : 100, perimeter(polygons) / kMostCorners));
      const bool moved = polygons.transformTo(&wanted) == OGRERR_NONE;
      polygons.assignSpatialReference(nullptr);
      if (!moved)
        throw IoError(path.string() + ": a polygon cannot be brought into the images' zone (" +
                      gdal_error() + "), expected one of the images' ground");
      for (const OGRPolygon* polygon : polygons) all.addGeometry(polygon);
    }
  return std::unique_ptr<OGRGeometry>(all.UnionCascaded());
}

}  // namespace

bool is_vector_file(const fs::path& path) {
  std::vector<std::string> names = vector_drivers();
  std::vector<const char*> list;
  for (const std::string& n : names) list.push_back(n.c_str());
  list.push_back(nullptr);
  const std::string name = path.string();
  return !name.starts_with("/vsi") &&
         GDALIdentifyDriverEx(name.c_str(), GDAL_OF_VECTOR, list.data(), nullptr) != nullptr;
}

std::vector<double> Area::crossings(double northing) const {
  std::vector<double> out;
  for (const auto& ring : rings)
    for (std::size_t i = 0, j = ring.size() - 1; i < ring.size(); j = i++) {
      const std::array<double, 2>&a = ring[i], &b = ring[j];
      if ((a[1] > northing) != (b[1] > northing))
        out.push_back(a[0] + (northing - a[1]) / (b[1] - a[1]) * (b[0] - a[0]));
    }
  std::sort(out.begin(), out.end());
  return out;
}

bool Area::contains(double easting, double northing) const {
  const std::vector<double> sides = crossings(northing);
  return (std::upper_bound(sides.begin(), sides.end(), easting) - sides.begin()) % 2 != 0;
}

std::array<double, 4> Area::bounds() const {
  constexpr double kFar = std::numeric_limits<double>::infinity();
  std::array<double, 4> out{kFar, kFar, -kFar, -kFar};
  for (const auto& ring : rings)
    for (const auto& [x, y] : ring)
      out = {std::min(out[0], x), std::min(out[1], y), std::max(out[2], x), std::max(out[3], y)};
  return out;
}

Area area_of_box(const std::array<double, 4>& box, const UtmZone& zone) {
  constexpr double kWidest = 10;  // degrees; a zone is six wide
  constexpr int kParts = 32;      // of a side
  const auto [west, south, east, north] = box;
  if (!(west < east && south < north && east - west <= kWidest && north - south <= kWidest &&
        std::abs(west) <= 180 && std::abs(east) <= 180 && south >= -90 && north <= 90)) {
    std::ostringstream text;
    text << "bbox: " << west << ',' << south << ',' << east << ',' << north
         << ", expected west, south, east and north in degrees, of at most 10 a side";
    throw ConfigError(text.str());
  }
  Area area;
  auto& ring = area.rings.emplace_back();
  const std::array<std::array<double, 2>, 5> corners{
      {{west, south}, {east, south}, {east, north}, {west, north}, {west, south}}};
  for (std::size_t k = 0; k < 4; ++k)
    for (int i = 0; i < kParts; ++i) {
      const double f = static_cast<double>(i) / kParts;
      ring.push_back(utm_from_geodetic(zone,
                                       corners[k][0] + f * (corners[k + 1][0] - corners[k][0]),
                                       corners[k][1] + f * (corners[k + 1][1] - corners[k][1])));
    }
  return area;
}

Area read_area(const fs::path& path, const UtmZone& zone) {
  const GdalScope scope;
  require_file(path, "a vector file of polygons");
  std::vector<std::string> names = vector_drivers();
  std::vector<const char*> list;
  for (const std::string& n : names) list.push_back(n.c_str());
  list.push_back(nullptr);
  const unsigned flags = GDAL_OF_VECTOR | GDAL_OF_READONLY | GDAL_OF_VERBOSE_ERROR;
  const DatasetPtr d(GDALDataset::FromHandle(
      GDALOpenEx(path.string().c_str(), flags, list.data(), nullptr, nullptr)));
  if (!d)
    throw IoError(path.string() +
                  ": not a vector file that can be read, expected GeoJSON, GeoPackage, a shapefile "
                  "or alike; " +
                  gdal_error());
  OGRSpatialReference wanted;
  if (wanted.importFromEPSG(zone.epsg()) != OGRERR_NONE)
    throw Error("EPSG:" + std::to_string(zone.epsg()) + ": not known to GDAL, expected UTM");
  wanted.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
  Area area;
  if (const auto all = polygons_of(path, *d, wanted)) add_rings(area, *all);
  if (area.rings.empty())
    throw IoError(path.string() + ": no polygon, expected at least one around the ground");
  return area;
}

}  // namespace satsurf::rpc

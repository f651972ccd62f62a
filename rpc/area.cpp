// SPDX-License-Identifier: Apache-2.0
#include "satsurf/rpc/area.h"

#include "satsurf/rpc/gdal.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <memory>
#include <span>
#include <sstream>
#include <vector>

#include <ogrsf_frmts.h>

namespace satsurf::rpc {
namespace {

namespace fs = std::filesystem;

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

/// A geometry's polygons in the zone; none where it has none.
/// layer   for its reference system
/// wanted  of the zone
/// throws  IoError
OGRMultiPolygon in_zone(const fs::path& path, const OGRGeometry& geometry, OGRLayer& layer,
                        OGRSpatialReference& wanted) {
  std::unique_ptr<OGRGeometry> flat(geometry.getLinearGeometry());
  flat->flattenTo2D();
  OGRMultiPolygon polygons;
  take_polygons(*flat, polygons);
  if (polygons.IsEmpty()) return polygons;
  const OGRSpatialReference* crs = layer.GetSpatialRef();
  if (crs == nullptr)
    throw IoError(path.string() + ": the layer " + layer.GetName() +
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
  return polygons;
}

/// Counts what is read of a vector file.
class Counted {
 public:
  Counted(const fs::path& path, const std::function<void()>& poll) : path_(path), poll_(poll) {}

  /// throws  IoError; what `poll` does
  void add_feature() {
    constexpr int kMost = 100'000;
    if (poll_ && features_ % 100 == 0) poll_();
    if (++features_ > kMost) refuse("features", kMost);
  }
  /// throws  IoError
  void add(const OGRMultiPolygon& polygons) {
    constexpr int kMostRings = 20'000, kMost = 200'000;  // joined in some seconds
    for (const OGRPolygon* polygon : polygons)
      for (const OGRLinearRing* ring : *polygon) corners_ += ring->getNumPoints(), ++rings_;
    if (rings_ > kMostRings) refuse("rings of polygons", kMostRings);
    if (corners_ > kMost) refuse("corners", kMost);
  }

 private:
  [[noreturn]] void refuse(const std::string& what, int most) const {
    throw IoError(path_.string() + ": more than " + std::to_string(most) + " " + what +
                  ", expected the polygons around some ground; cut or join them (ogr2ogr)");
  }

  const fs::path& path_;
  const std::function<void()>& poll_;
  int features_ = 0, rings_ = 0;
  Index corners_ = 0;
};

/// Joins polygons, so that those that overlap count once; the nearest first, with time to ask for
/// signals between.
/// across  whether to part them by their eastings, else by their northings
/// returns nothing where GEOS cannot
std::unique_ptr<OGRGeometry> joined(std::span<const OGRPolygon*> polygons,
                                    const std::function<void()>& poll, bool across = true) {
  constexpr std::size_t kFew = 64;
  if (poll) poll();
  if (polygons.size() <= kFew) {
    OGRMultiPolygon few;
    for (const OGRPolygon* polygon : polygons) few.addGeometry(polygon);
    return std::unique_ptr<OGRGeometry>(few.UnionCascaded());
  }
  const auto place = [&](const OGRPolygon* polygon) {
    OGREnvelope box;
    polygon->getEnvelope(&box);
    return across ? box.MinX + box.MaxX : box.MinY + box.MaxY;
  };
  std::ranges::stable_sort(polygons, {}, place);
  const std::size_t half = polygons.size() / 2;
  const auto low = joined(polygons.first(half), poll, !across);
  const auto high = low ? joined(polygons.subspan(half), poll, !across) : nullptr;
  if (poll) poll();
  return std::unique_ptr<OGRGeometry>(high ? low->Union(high.get()) : nullptr);
}

/// The polygons of all layers as one; nothing where there are none.
/// throws  IoError; what `poll` does
std::unique_ptr<OGRGeometry> polygons_of(const fs::path& path, GDALDataset& d,
                                         OGRSpatialReference& wanted,
                                         const std::function<void()>& poll) {
  std::vector<OGRMultiPolygon> found;
  Counted counted(path, poll);
  for (OGRLayer* layer : d.GetLayers())
    for (auto& feature : *layer) {
      counted.add_feature();
      const OGRGeometry* geometry = feature->GetGeometryRef();
      if (geometry == nullptr) continue;
      found.push_back(in_zone(path, *geometry, *layer, wanted));
      counted.add(found.back());
    }
  std::vector<const OGRPolygon*> all;
  for (const OGRMultiPolygon& polygons : found)
    for (const OGRPolygon* polygon : polygons) all.push_back(polygon);
  if (all.empty()) return nullptr;
  auto area = joined(all, poll);
  if (!area)
    throw IoError(path.string() + ": its polygons cannot be joined (" + gdal_error() +
                  "), expected such as do not cross themselves");
  return area;
}

/// Opens a vector file of one of the known formats. Needs a GdalScope.
/// throws  IoError
DatasetPtr open_vector(const fs::path& path) {
  require_file(path, "a vector file of polygons");
  names_beside(path);
  // A view of a GeoPackage may have rows without end, or none and no end, and any of its tables may be
  // one, those that are read to open it too; SQLite says so by the one error a query can make.
  const char* const no_views =
      "PRELUDE_STATEMENTS=SELECT CASE WHEN EXISTS(SELECT 1 FROM sqlite_master WHERE type='view') "
      "THEN abs(-9223372036854775807 - 1) END";
  const std::vector<std::string> names = vector_drivers();
  const std::vector<const char*> list = list_of(names);
  const GDALDriverH driver =
      GDALIdentifyDriverEx(path.string().c_str(), GDAL_OF_VECTOR, list.data(), nullptr);
  const bool package = driver != nullptr && EQUAL(GDALGetDriverShortName(driver), "GPKG");
  const char* const options[] = {package ? no_views : nullptr, nullptr};
  const unsigned flags = GDAL_OF_VECTOR | GDAL_OF_READONLY | GDAL_OF_VERBOSE_ERROR;
  DatasetPtr d(GDALDataset::FromHandle(
      GDALOpenEx(path.string().c_str(), flags, list.data(), options, nullptr)));
  check_refused(path);
  if (d) return d;
  const std::string why = gdal_error();
  if (package && why.find("integer overflow") != std::string::npos)
    throw IoError(path.string() +
                  ": holds views, expected tables alone; ogr2ogr makes one of a view");
  if (driver == nullptr)
    if (const std::string format = format_of(path.string(), GDAL_OF_VECTOR); !format.empty())
      throw IoError(path.string() + ": of the format " + format +
                    ", expected GeoJSON, GeoPackage, a shapefile or alike" + allow_text(format));
  throw IoError(path.string() +
                ": not a vector file that can be read, expected GeoJSON, GeoPackage, a shapefile "
                "or alike; " +
                why);
}

}  // namespace

bool is_vector_file(const fs::path& path) {
  const std::vector<std::string> names = vector_drivers();
  const std::string name = path.string();
  return !name.starts_with("/vsi") &&
         GDALIdentifyDriverEx(name.c_str(), GDAL_OF_VECTOR, list_of(names).data(), nullptr) !=
             nullptr;
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

Tensor Area::cells(const GeoGrid& grid, Index height, Index width) const {
  Tensor out({height, width});
  for (Index y = 0; y < height; ++y) {
    const std::vector<double> sides =
        crossings(grid.y0 - (static_cast<double>(y) + 0.5) * grid.step);
    std::size_t passed = 0;
    for (Index x = 0; x < width && !sides.empty(); ++x) {
      const double east = grid.x0 + (static_cast<double>(x) + 0.5) * grid.step;
      while (passed < sides.size() && sides[passed] <= east) ++passed;
      out[y * width + x] = passed % 2 != 0 ? 1.0F : 0.0F;
    }
  }
  return out;
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
  const auto [west, south, named_east, north] = box;
  // Beyond the antimeridian longitudes begin again.
  const bool across = named_east < west && named_east + 360 - west <= kWidest;
  const double east = across ? named_east + 360 : named_east;
  if (!(west < east && south < north && east - west <= kWidest && north - south <= kWidest &&
        std::abs(west) <= 180 && std::abs(named_east) <= 180 && south >= -90 && north <= 90)) {
    std::ostringstream text;
    text << "bbox: " << west << ',' << south << ',' << named_east << ',' << north
         << ", expected west, south, east and north in degrees, of at most 10 a side, with west "
            "above "
            "east only across the antimeridian";
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

Area read_area(const fs::path& path, const UtmZone& zone, const std::function<void()>& poll) {
  const GdalScope scope;
  const DatasetPtr d = open_vector(path);
  OGRSpatialReference wanted;
  if (wanted.importFromEPSG(zone.epsg()) != OGRERR_NONE)
    throw Error("EPSG:" + std::to_string(zone.epsg()) + ": not known to GDAL, expected UTM");
  wanted.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
  Area area;
  const auto all = polygons_of(path, *d, wanted, poll);
  check_refused(path);
  if (all) add_rings(area, *all);
  if (area.rings.empty())
    throw IoError(path.string() + ": no polygon, expected at least one around the ground");
  return area;
}

}  // namespace satsurf::rpc

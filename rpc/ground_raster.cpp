// SPDX-License-Identifier: Apache-2.0
#include "satsurf/rpc/ground_raster.h"

#include "satsurf/rpc/area.h"
#include "satsurf/rpc/camera_check.h"
#include "satsurf/rpc/gdal.h"
#include "satsurf/rpc/geoid.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <mutex>
#include <optional>
#include <sstream>
#include <utility>
#include <vector>

#include <ogr_spatialref.h>

namespace satsurf::rpc {
namespace {

namespace fs = std::filesystem;

/// A raster that lies somewhere.
struct Placed {
  DatasetPtr file;    ///< what `raster` reads from, if that is another
  DatasetPtr raster;  ///< before it in the order of destruction
  OGRSpatialReference crs;
};

/// Side of a raster's cell, about, m.
double cell_of(const OGRSpatialReference& crs, GDALDataset& d) {
  constexpr double kDegree = 111e3;  // m
  std::array<double, 6> t{};
  d.GetGeoTransform(t.data());
  const double side = std::max(std::hypot(t[1], t[4]), std::hypot(t[2], t[5]));
  return side * (crs.IsGeographic() ? kDegree : crs.GetLinearUnits());
}

/// throws  IoError for a raster that lies nowhere on the Earth
void check_place(const fs::path& path, const Placed& at) {
  constexpr double kFarthest = 1e8, kFinest = 1e-3;  // m; as of rasters that are read whole
  std::array<double, 6> t{};
  at.raster->GetGeoTransform(t.data());
  const bool near = std::ranges::all_of(t, [](double v) { return std::abs(v) <= kFarthest; });
  const double cell = cell_of(at.crs, *at.raster);
  if (near && cell >= kFinest && cell <= kFarthest) return;
  std::ostringstream text;
  text << path.string() << ": a grid at (" << t[0] << ", " << t[3] << ") of cells of about " << cell
       << " m, expected finite numbers of at most 1e8 and cells of 0.001 m or more";
  throw IoError(text.str());
}

/// zone    of a raster of DFC2019, which has its place in a text file beside it and names no system
/// throws  IoError
Placed open_placed(const fs::path& path, const UtmZone& zone) {
  Placed out;
  out.raster = open_raster(path);
  if (!has_place(*out.raster)) {
    const GeoGrid grid = grid_of(path, *out.raster, zone);
    out.file = std::move(out.raster);
    GDALDriver* vrt = GetGDALDriverManager()->GetDriverByName("VRT");
    out.raster.reset(vrt == nullptr
                         ? nullptr
                         : vrt->CreateCopy("", out.file.get(), 0, nullptr, nullptr, nullptr));
    std::array<double, 6> place{grid.x0, grid.step, 0, grid.y0, 0, -grid.step};
    if (!out.raster || out.raster->SetGeoTransform(place.data()) != CE_None ||
        out.crs.importFromEPSG(grid.epsg) != OGRERR_NONE)
      throw IoError(path.string() + ": GDAL cannot place it by its grid: " + gdal_error());
  } else {
    const OGRSpatialReference* crs = out.raster->GetSpatialRef();
    if (crs == nullptr) throw IoError(path.string() + ": names no reference system, expected one");
    out.crs = *crs;
  }
  out.crs.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
  check_place(path, out);
  return out;
}

constexpr UtmZone kAnyZone{.number = 31, .north = true};  // where only the file is looked at

/// Heights of zero and of one in a vertical system, m above the ellipsoid.
struct Lifted {
  double zero = 0, one = 1;
};

/// throws  Error where PROJ has no grid of the system
std::vector<Lifted> lifted(int epsg_up, const std::vector<std::array<double, 2>>& lon_lat) {
  OGRSpatialReference up;
  if (up.importFromEPSG(epsg_up) != OGRERR_NONE)
    throw Error("EPSG:" + std::to_string(epsg_up) +
                ": not known to PROJ, expected a vertical system");
  const auto heights = [&](double h) {
    auto out = above_ellipsoid(up, lon_lat, h);
    if (!out)
      throw Error(std::string("its heights are in ") + up.GetName() +
                  ", expected a vertical system of which PROJ has the grid here");
    return std::move(*out);
  };
  const std::vector<double> zero = heights(0), one = heights(1);
  std::vector<Lifted> out;
  for (std::size_t i = 0; i < zero.size(); ++i) out.push_back({zero[i], one[i]});
  return out;
}

/// Points spread over some ground, degrees.
std::vector<std::array<double, 2>> spread(const UtmZone& zone, const std::array<double, 4>& g) {
  constexpr int kParts = 4;  // of a side; geoids are smooth
  std::vector<std::array<double, 2>> out;
  for (int i = 0; i <= kParts; ++i)
    for (int j = 0; j <= kParts; ++j)
      out.push_back(geodetic_from_utm(zone, g[0] + (g[2] - g[0]) * j / kParts,
                                      g[1] + (g[3] - g[1]) * i / kParts));
  return out;
}

/// Heights above the ellipsoid, by the lowest and the highest place of what they are above.
HeightRange lifted(const HeightRange& heights, const std::vector<Lifted>& by) {
  HeightRange out{INFINITY, -INFINITY};
  for (const auto& [zero, one] : by)
    for (const double h : {heights.low, heights.high}) {
      const double v = zero + h * (one - zero);
      out = {std::min(out.low, v), std::max(out.high, v)};
    }
  return out;
}

}  // namespace

/// Polygons in the zone that was asked for last.
struct GroundMask::Polygons {
  std::mutex mutex;
  UtmZone zone;
  std::optional<Area> area;
};

GroundMask::GroundMask(const fs::path& path, std::vector<double> values)
    : path_(path), values_(std::move(values)) {
  const GdalScope scope;
  require_file(path, "a raster or polygons");
  if (is_vector_file(path)) {
    if (!values_.empty())
      throw ConfigError("mask_values came for the polygons of " + path.string() +
                        ", expected a raster");
    polygons_ = std::make_unique<Polygons>();
    return;
  }
  check_content(path, *open_placed(path, kAnyZone).raster);
}

GroundMask::~GroundMask() = default;

bool GroundMask::covers(float value) const {
  if (!std::isfinite(value)) return false;
  return values_.empty() ? value != 0 : std::ranges::any_of(values_, [&](double v) {
    return static_cast<float>(v) == value;
  });
}

Tensor GroundMask::on(const GeoGrid& grid, Index height, Index width) const {
  const std::optional<UtmZone> zone = zone_of_epsg(grid.epsg);
  if (!zone)
    throw Error("GroundMask::on: a grid in EPSG:" + std::to_string(grid.epsg) +
                ", expected a zone of UTM (EPSG:326xx or 327xx)");
  if (!polygons_) {
    const GdalScope scope;
    const Placed at = open_placed(path_, *zone);
    Tensor out = first_band_on(*at.raster, at.crs, grid, height, width, Sampled::nearest);
    for (float& v : out.values()) v = covers(v) ? 1.0F : 0.0F;
    return out;
  }
  const std::lock_guard lock(polygons_->mutex);
  if (!polygons_->area || polygons_->zone != *zone)
    polygons_->area = read_area(path_, *zone), polygons_->zone = *zone;
  return polygons_->area->cells(grid, height, width);
}

Terrain::Terrain(const fs::path& path) : path_(path) {
  const GdalScope scope;
  const Placed at = open_placed(path, kAnyZone);
  check_content(path, *at.raster);
  const std::string unit = at.raster->GetRasterBand(1)->GetUnitType();
  for (const char* metre : {"", "m", "metre", "meter", "metres", "meters"})
    if (EQUAL(unit.c_str(), metre)) return;
  throw IoError(path.string() + ": heights in " + unit + ", expected metres");
}

TerrainHeights Terrain::over(const UtmZone& zone, const std::array<double, 4>& ground) const {
  constexpr Index kMost = 256;  // cells a side: of the raster's in one of them the extremes count
  const GdalScope scope;
  const auto [file, d, crs] = open_placed(path_, zone);
  const double rim = 2 * cell_of(crs, *d);  // what lies beside matters where its cells are large
  const std::array<double, 4> all{ground[0] - rim, ground[1] - rim, ground[2] + rim,
                                  ground[3] + rim};
  const double side = std::max(all[2] - all[0], all[3] - all[1]);
  const double step = std::max(side / static_cast<double>(kMost), 0.5);
  const GeoGrid grid{zone.epsg(), all[0], all[3], step};
  const auto cells = [&](double length) {
    return std::max<Index>(1, static_cast<Index>(std::ceil(length / step)));
  };
  const Index H = cells(all[3] - all[1]), W = cells(all[2] - all[0]);
  const Tensor low = first_band_on(*d, crs, grid, H, W, Sampled::lowest),
               high = first_band_on(*d, crs, grid, H, W, Sampled::highest);
  TerrainHeights out;
  HeightRange found{INFINITY, -INFINITY};
  double inside = 0, known = 0;
  for (Index i = 0; i < H * W; ++i) {
    const double x = grid.x0 + (static_cast<double>(i % W) + 0.5) * step,
                 y = grid.y0 - (static_cast<double>(i / W) + 0.5) * step;
    const bool counts = x > ground[0] && x < ground[2] && y > ground[1] && y < ground[3];
    inside += counts ? 1 : 0;
    if (!std::isfinite(low[i]) || !std::isfinite(high[i])) continue;
    known += counts ? 1 : 0;
    found = hull(found, {static_cast<double>(low[i]), static_cast<double>(high[i])});
  }
  if (!(known > 0)) return out;
  if (!on_earth(found)) {
    std::ostringstream text;
    text << path_.string() << ": heights from " << found.low << " to " << found.high
         << " m, expected at most 1000 km either way";
    throw IoError(text.str());
  }
  out.covered = known / inside;

  const auto metadata = metadata_of(*d, "");
  const auto said = metadata.find("VERTICAL_DATUM");
  const bool ellipsoid =
      (crs.GetAxesCount() == 3 && !crs.IsCompound()) ||
      (said != metadata.end() && said->second == datum_text(HeightDatum::ellipsoid));
  const std::vector<std::array<double, 2>> points = spread(zone, ground);
  if (crs.IsCompound()) {
    const char* code = crs.GetAuthorityCode("VERT_CS");
    if (code == nullptr)
      throw Error("its vertical system has no EPSG code, expected one that PROJ knows");
    out.heights = lifted(found, lifted(std::atoi(code), points));
    return out;
  }
  out.heights = found;
  if (ellipsoid) return out;
  out.either = true;
  try {
    out.heights = hull(found, lifted(found, lifted(height_epsg(HeightDatum::egm96), points)));
  } catch (const Error&) {  // without the grid the ellipsoid is all there is to go by
  }
  return out;
}

}  // namespace satsurf::rpc

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/rpc/crs.h"

#include "satsurf/rpc/gdal.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include <ogr_spatialref.h>

namespace satsurf::rpc {
namespace {

/// throws  ConfigError naming what came instead of a projected system in metres
void check_kind(const OGRSpatialReference& crs, const std::string& text) {
  const auto refuse = [&](const std::string& what) {
    throw ConfigError("crs: " + text.substr(0, 200) + " " + what +
                      ", expected a projected system in metres, as EPSG:32631 is");
  };
  if (crs.IsCompound())
    refuse("is a compound system with heights (--geoid says what they are above)");
  if (crs.IsGeographic()) refuse("counts in degrees");
  if (!crs.IsProjected()) refuse("is no projected system");
  const char* unit = nullptr;
  const double metres = crs.GetLinearUnits(&unit);
  if (std::abs(metres - 1) > 1e-9)
    refuse(std::string("counts in ") + (unit == nullptr ? "another unit" : unit));
}

/// PROJ's words for an area of use, of those that fill a page the first ones.
/// name  may be null
std::string place_text(const char* name) {
  constexpr std::size_t kMost = 500;  // lists of countries are shorter
  if (name == nullptr) return "another place";
  std::string text = name;
  if (text.size() > kMost) return text.substr(0, text.rfind(' ', kMost)) + " ...";
  if (text.ends_with('.')) text.pop_back();
  return text;
}

}  // namespace

std::string wkt_of(const OGRSpatialReference& crs, const char* form) {
  CPLStringList options;
  if (form != nullptr) options.SetNameValue("FORMAT", form);
  char* text = nullptr;
  crs.exportToWkt(&text, options.List());
  const std::string wkt = text == nullptr ? "" : text;
  CPLFree(text);
  return wkt;
}

ProjectedCrs projected_crs(const std::string& text) {
  const GdalScope scope;
  OGRSpatialReference crs;
  if (crs.SetFromUserInput(
          text.c_str(), OGRSpatialReference::SET_FROM_USER_INPUT_LIMITATIONS_get()) != OGRERR_NONE)
    throw ConfigError("crs: " + text.substr(0, 200) +
                      " names no reference system, expected a code such as EPSG:32631, WKT or a "
                      "string of PROJ");
  check_kind(crs, text);
  ProjectedCrs out;
  out.wkt = wkt_of(crs, "WKT2_2019");
  const char *authority = crs.GetAuthorityName(nullptr), *code = crs.GetAuthorityCode(nullptr);
  const char* name = crs.GetName();
  if (authority != nullptr && code != nullptr) {
    out.label = std::string(authority) + ":" + code;
    if (std::string(authority) == "EPSG") out.epsg = std::atoi(code);
  } else {
    out.label = name == nullptr ? "unnamed" : name;
  }
  return out;
}

void check_area_of_use(const ProjectedCrs& crs, double lon, double lat) {
  constexpr double kBeyond = 2;  // degrees; grids are in use somewhat beyond their areas
  const GdalScope scope;
  OGRSpatialReference system;
  double west = 0, south = 0, east = 0, north = 0;
  const char* name = nullptr;
  if (system.importFromWkt(crs.wkt.c_str()) != OGRERR_NONE ||
      !system.GetAreaOfUse(&west, &south, &east, &north, &name) || west <= -1000)
    return;
  // how far a meridian lies to the east of the western one, on the way round the Earth
  const auto from_west = [&](double at) { return at - west - 360 * std::floor((at - west) / 360); };
  const double width = from_west(east) == 0 && east != west ? 360 : from_west(east),
               passed = from_west(lon);
  const double beside = passed <= width ? 0 : std::min(passed - width, 360 - passed);
  const double above = std::max({0.0, south - lat, lat - north});
  if (beside <= kBeyond && above <= kBeyond) return;
  char lies[200];
  std::snprintf(lies, sizeof lies,
                " (lon %.1f to %.1f, lat %.1f to %.1f), the images lie at lon %.2f, lat %.2f, "
                "expected a system for there",
                west, east, south, north, lon, lat);
  throw ConfigError("crs: " + crs.label + " is for " + place_text(name) + lies);
}

}  // namespace satsurf::rpc

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/rpc/drivers.h"

#include "satsurf/core/nearest.h"
#include "satsurf/rpc/gdal.h"

#include <algorithm>
#include <cstdlib>
#include <iterator>
#include <mutex>
#include <set>
#include <sstream>
#include <utility>

namespace satsurf::rpc {
namespace {

/// For the formats that images and surface models come in; see rpc/drivers.h. HFA is none of them: its
/// driver takes whatever memory a file says that an entry or a packed block needs.
constexpr const char* kRaster[] = {"GTiff", "NITF", "JP2OpenJPEG", "JP2KAK", "JP2ECW",
                                   "DIMAP", "VRT",  "PNG",         "JPEG",   "BMP",
                                   "ENVI",  "EHdr", "PCIDSK",      "AAIGrid"};
/// For polygons. GML is none of them: to open one may fetch its schema, and writes a file beside it.
constexpr const char* kVector[] = {"GeoJSON", "GPKG", "ESRI Shapefile",
                                   "LIBKML",  "KML",  "FlatGeobuf"};
constexpr const char* kWritten[] = {"COG", "MEM", "Memory"};  // what is made here, besides

std::vector<std::string>& named() {
  static std::vector<std::string> names;
  return names;
}

/// Drivers that were registered here and may not open anything. It outlives every other object, as
/// those that are registered do.
struct SetAside {
  std::mutex mutex;
  std::vector<GDALDriver*> drivers;
};
SetAside& set_aside() {
  static auto& all = *new SetAside;
  return all;
}

bool is_named(const std::vector<std::string>& names, const GDALDriver& driver) {
  return std::ranges::any_of(
      names, [&](const std::string& name) { return EQUAL(name.c_str(), driver.GetDescription()); });
}

/// Registers those of the drivers set aside that have one of some names.
void bring_back(const std::vector<std::string>& names) {
  SetAside& aside = set_aside();
  const std::lock_guard lock(aside.mutex);
  std::erase_if(aside.drivers, [&](GDALDriver* driver) {
    const bool wanted = is_named(names, *driver);
    if (wanted) GetGDALDriverManager()->RegisterDriver(driver);
    return wanted;
  });
}

template <std::size_t N>
std::vector<std::string> with_trusted(const char* const (&own)[N]) {
  std::vector<std::string> names(std::begin(own), std::end(own));
  const std::vector<std::string> trusted = trusted_drivers();
  if (!trusted.empty()) bring_back(trusted);
  std::ranges::copy(trusted, std::back_inserter(names));
  return names;
}

/// The names of all drivers, sorted.
std::vector<std::string> all_drivers() {
  std::set<std::string> names;
  GDALDriverManager& manager = *GetGDALDriverManager();
  for (int i = 0; i < manager.GetDriverCount(); ++i)
    names.insert(manager.GetDriver(i)->GetDescription());
  SetAside& aside = set_aside();
  const std::lock_guard lock(aside.mutex);
  for (const GDALDriver* driver : aside.drivers) names.insert(driver->GetDescription());
  return {names.begin(), names.end()};
}

/// throws  ConfigError
void check_name(const std::string& name, const std::vector<std::string>& known) {
  if (std::ranges::any_of(known,
                          [&](const std::string& k) { return EQUAL(k.c_str(), name.c_str()); }))
    return;
  const std::optional<std::string> meant = nearest(name, known);
  std::string text = "gdal_drivers: " + name + " is no driver of this GDAL, ";
  if (meant) text += "did you mean " + *meant + "? ";
  text += "expected some of";
  for (const std::string& k : known) text += (k == known.front() ? " " : ", ") + k;
  throw ConfigError(text);
}

}  // namespace

void trust_drivers(std::vector<std::string> names) {
  named() = std::move(names);
  const std::vector<std::string> trusted = trusted_drivers();
  if (trusted.empty()) return;  // most programs: GDAL can wait until something is read
  register_drivers();
  const std::vector<std::string> known = all_drivers();
  for (const std::string& name : trusted) check_name(name, known);
}

std::vector<std::string> trusted_drivers() {
  std::vector<std::string> names = named();
  if (const char* more = std::getenv("SATSURF_GDAL_DRIVERS")) {
    std::istringstream in(more);
    for (std::string name; std::getline(in, name, ',');)
      if (!name.empty()) names.push_back(name);
  }
  return names;
}

std::vector<std::string> raster_drivers() { return with_trusted(kRaster); }
std::vector<std::string> vector_drivers() { return with_trusted(kVector); }

void register_drivers() {
  static const bool done = [] {
    GDALDriverManager& manager = *GetGDALDriverManager();
    std::vector<std::string> kept(std::begin(kRaster), std::end(kRaster));
    kept.insert(kept.end(), std::begin(kVector), std::end(kVector));
    kept.insert(kept.end(), std::begin(kWritten), std::end(kWritten));
    for (int i = 0; i < manager.GetDriverCount(); ++i)  // the calling program's own
      kept.push_back(manager.GetDriver(i)->GetDescription());
    GDALAllRegister();
    SetAside& aside = set_aside();
    const std::lock_guard lock(aside.mutex);
    for (int i = manager.GetDriverCount() - 1; i >= 0; --i)
      if (GDALDriver* driver = manager.GetDriver(i); !is_named(kept, *driver)) {
        manager.DeregisterDriver(driver);
        aside.drivers.push_back(driver);
      }
    return true;
  }();
  static_cast<void>(done);
}

std::string allow_text(const std::string& driver) {
  return driver.empty() ? "" : "; SATSURF_GDAL_DRIVERS=" + driver + " in the environment allows it";
}

std::string format_of(const std::string& name, unsigned kind) {
  const char* able = kind == GDAL_OF_RASTER ? GDAL_DCAP_RASTER : GDAL_DCAP_VECTOR;
  if (const GDALDriverH found = GDALIdentifyDriverEx(name.c_str(), kind, nullptr, nullptr))
    return GDALGetDriverShortName(found);
  SetAside& aside = set_aside();
  const std::lock_guard lock(aside.mutex);
  GDALOpenInfo info(name.c_str(), static_cast<int>(kind | GDAL_OF_READONLY));
  for (GDALDriver* driver : aside.drivers)
    if (driver->pfnIdentify != nullptr && driver->GetMetadataItem(able) != nullptr &&
        driver->pfnIdentify(&info) > 0)
      return driver->GetDescription();
  return "";
}

}  // namespace satsurf::rpc

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/memory.h"
#include "satsurf/rpc/drivers.h"
#include "satsurf/rpc/gdal.h"

#include <algorithm>
#include <cstdlib>
#include <iterator>
#include <sstream>

#include <cpl_minixml.h>

namespace satsurf::rpc {
namespace {

namespace fs = std::filesystem;

/// GDAL's drivers for the formats that images and surface models come in; see rpc/drivers.h.
constexpr const char* kDrivers[] = {"GTiff", "NITF", "JP2OpenJPEG", "JP2KAK", "JP2ECW",
                                    "DIMAP", "VRT",  "PNG",         "JPEG",   "BMP",
                                    "HFA",   "ENVI", "EHdr",        "PCIDSK", "AAIGrid"};

std::vector<std::string> allowed_drivers() {
  std::vector<std::string> names(std::begin(kDrivers), std::end(kDrivers));
  std::ranges::copy(trusted_drivers(), std::back_inserter(names));
  return names;
}

/// The driver that would open a file, by its beginning; empty if none would.
std::string driver_of(const std::string& name) {
  const GDALDriverH driver = GDALIdentifyDriverEx(name.c_str(), GDAL_OF_RASTER, nullptr, nullptr);
  return driver == nullptr ? "" : GDALGetDriverShortName(driver);
}

/// What the user can do about a driver that is not among them.
std::string allow_text(const std::string& driver) {
  return driver.empty() ? "" : "; SATSURF_GDAL_DRIVERS=" + driver + " in the environment allows it";
}

bool is_allowed(const std::string& driver) {
  const auto names = allowed_drivers();
  return std::any_of(names.begin(), names.end(),
                     [&](const std::string& name) { return EQUAL(name.c_str(), driver.c_str()); });
}

struct XmlDeleter {
  void operator()(CPLXMLNode* node) const { CPLDestroyXMLNode(node); }
};

void check_sources(const fs::path& vrt, int depth);

/// throws  IoError unless a VRT's source is a file here, of a known format
void check_source(const fs::path& vrt, const CPLXMLNode* element, int depth) {
  const std::string said = CPLGetXMLValue(element, nullptr, "");
  const bool relative = std::atoi(CPLGetXMLValue(element, "relativeToVRT", "0")) != 0;
  const fs::path source = relative ? vrt.parent_path() / said : fs::path(said);
  const std::string where = vrt.string() + ": its source \"" + said.substr(0, 200) + "\"";
  if (!is_file(source)) throw IoError(where + " is no file, expected a raster on this machine");
  const std::string driver = driver_of(source.string());
  if (!is_allowed(driver))
    throw IoError(where + " is " + (driver.empty() ? "no raster" : "of the format " + driver) +
                  ", expected GeoTIFF, NITF or alike" + allow_text(driver));
  if (driver == "VRT") check_sources(source, depth + 1);
}

void check_elements(const fs::path& vrt, const CPLXMLNode* node, int depth) {
  for (; node != nullptr; node = node->psNext) {
    if (node->eType == CXT_Text &&
        std::string_view(node->pszValue).find("/vsi") != std::string_view::npos)
      throw IoError(vrt.string() + ": names \"" + std::string(node->pszValue).substr(0, 200) +
                    "\", expected files on this machine");
    if (node->eType == CXT_Element &&
        (EQUAL(node->pszValue, "SourceFilename") || EQUAL(node->pszValue, "SourceDataset")))
      check_source(vrt, node, depth);
    check_elements(vrt, node->psChild, depth);  // GDAL's parser bounds the nesting
  }
}

/// Looks at what a VRT names before GDAL does: opening may already open its sources.
/// throws  IoError
void check_sources(const fs::path& vrt, int depth) {
  constexpr int kMostDepth = 8;  // mosaics of mosaics; one that names itself would not end
  if (depth > kMostDepth)
    throw IoError(vrt.string() + ": a VRT of VRTs nested deeper than " +
                  std::to_string(kMostDepth) + ", expected files");
  const std::string text = read_text_file(vrt, "a VRT");
  const std::unique_ptr<CPLXMLNode, XmlDeleter> root(CPLParseXMLString(text.c_str()));
  if (!root) throw IoError(vrt.string() + ": damaged VRT; " + gdal_error());
  check_elements(vrt, root.get(), depth);
}

std::string size_text(GDALDataset& d) {
  std::ostringstream text;
  const int bands = d.GetRasterCount();
  text << d.GetRasterXSize() << " x " << d.GetRasterYSize() << " px of " << bands
       << (bands == 1 ? " band" : " bands");
  return text.str();
}

/// What GDAL makes of one block, the least it reads: of all bands where they lie side by side.
double block_bytes(GDALDataset& d) {
  const char* interleave = d.GetMetadataItem("INTERLEAVE", "IMAGE_STRUCTURE");
  const bool together = interleave != nullptr && EQUAL(interleave, "PIXEL");
  double most = 0, sum = 0;
  for (int b = 1; b <= d.GetRasterCount(); ++b) {
    int width = 0, height = 0;
    GDALRasterBand* band = d.GetRasterBand(b);
    band->GetBlockSize(&width, &height);
    const double bytes = static_cast<double>(width) * static_cast<double>(height) *
                         GDALGetDataTypeSizeBytes(band->GetRasterDataType());
    most = std::max(most, bytes), sum += bytes;
  }
  return together ? sum : most;
}

}  // namespace

DatasetPtr open_raster(const fs::path& path) {
  const std::string name = path.string();
  if (name.starts_with("/vsi"))
    throw IoError(name +
                  ": a name of GDAL's virtual file systems, expected a file on this machine");
  require_file(path, "a raster");
  const std::string driver = driver_of(name);
  if (!driver.empty() && !is_allowed(driver))
    throw IoError(name + ": of the format " + driver + ", expected GeoTIFF, NITF or alike" +
                  allow_text(driver));
  if (driver == "VRT") check_sources(path, 0);
  std::vector<std::string> names = allowed_drivers();
  std::vector<const char*> list;
  for (const std::string& n : names) list.push_back(n.c_str());
  list.push_back(nullptr);
  const unsigned flags = GDAL_OF_RASTER | GDAL_OF_READONLY | GDAL_OF_VERBOSE_ERROR;
  DatasetPtr d(
      GDALDataset::FromHandle(GDALOpenEx(name.c_str(), flags, list.data(), nullptr, nullptr)));
  if (!d)
    throw IoError(name + ": not a raster that can be read, expected GeoTIFF, NITF or alike; " +
                  gdal_error());
  if (d->GetRasterCount() == 0)
    throw IoError(name +
                  ": holds no bands of its own, expected an image; extract one of its subdatasets "
                  "(gdal_translate)");
  return d;
}

void check_content(const fs::path& path, GDALDataset& d) {
  // DEFLATE packs 1000 equal bytes into one, ZSTD and LZMA some 10000; sparse files leave out whole
  // tiles. What needs little memory is not worth a refusal.
  constexpr double kMostPacked = 100'000, kLittle = 256.0 * (1 << 20);
  double pixels = 0;  // bytes as they are stored, before packing
  for (int b = 1; b <= d.GetRasterCount(); ++b)
    pixels += GDALGetDataTypeSizeBytes(d.GetRasterBand(b)->GetRasterDataType());
  pixels *= static_cast<double>(d.GetRasterXSize()) * static_cast<double>(d.GetRasterYSize());
  const double block = block_bytes(d), bytes = std::max(pixels, block);
  if (bytes <= kLittle) return;
  double stored = 0;
  char** files = d.GetFileList();  // of a mosaic, its parts too
  for (int i = 0; files && files[i]; ++i) {
    std::error_code error;
    const auto size = fs::file_size(files[i], error);
    if (!error) stored += static_cast<double>(size);
  }
  CSLDestroy(files);
  if (bytes <= kMostPacked * stored) return;
  std::ostringstream text;
  text << path.string() << ": " << size_text(d) << (block > pixels ? " in blocks of " : ", ")
       << memory_text(bytes) << ", in a file of " << static_cast<long long>(stored)
       << " bytes, expected at least a byte for every " << static_cast<int>(kMostPacked)
       << "; empty or damaged?";
  throw IoError(text.str());
}

void check_memory(const fs::path& path, GDALDataset& d, double needed) {
  const auto available = static_cast<double>(available_memory());
  needed += block_bytes(d);
  if (needed <= available) return;
  throw IoError(path.string() + ": " + size_text(d) + " take " + memory_text(needed) +
                " of memory, expected " + memory_text(available) +
                " at most; cut it into smaller ones (gdal_translate -srcwin)");
}

}  // namespace satsurf::rpc

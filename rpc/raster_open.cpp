// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/memory.h"
#include "satsurf/rpc/gdal.h"

#include <algorithm>
#include <sstream>

namespace satsurf::rpc {
namespace {

namespace fs = std::filesystem;

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

std::vector<const char*> list_of(const std::vector<std::string>& texts) {
  std::vector<const char*> list;
  for (const std::string& text : texts) list.push_back(text.c_str());
  list.push_back(nullptr);
  return list;
}

DatasetPtr open_raster(const fs::path& path) {
  const std::string name = path.string();
  if (name.starts_with("/vsi"))
    throw IoError(name +
                  ": a name of GDAL's virtual file systems, expected a file on this machine");
  require_file(path, "a raster");
  // GDAL itself lists no folder of more than a thousand and asks for each name instead.
  constexpr std::size_t kMostBeside = 1000;
  std::vector<std::string> beside = names_beside(path);
  if (beside.size() > kMostBeside) beside.clear();
  check_format(path);
  const std::vector<std::string> names = raster_drivers();
  const std::vector<const char*> list = list_of(names);
  const std::vector<const char*> siblings = list_of(beside);  // which has to outlive it
  const unsigned flags = GDAL_OF_RASTER | GDAL_OF_READONLY | GDAL_OF_VERBOSE_ERROR;
  DatasetPtr d(GDALDataset::FromHandle(GDALOpenEx(name.c_str(), flags, list.data(), nullptr,
                                                  beside.empty() ? nullptr : siblings.data())));
  check_refused(path);
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
  double pixels = 0;  // bytes as they are stored, before packing
  for (int b = 1; b <= d.GetRasterCount(); ++b)
    pixels += GDALGetDataTypeSizeBytes(d.GetRasterBand(b)->GetRasterDataType());
  pixels *= static_cast<double>(d.GetRasterXSize()) * static_cast<double>(d.GetRasterYSize());
  const double block = block_bytes(d), bytes = std::max(pixels, block);
  if (bytes <= kLittlePixels) return;
  double stored = 0;
  char** files = d.GetFileList();  // of a mosaic, its parts too
  for (int i = 0; files && files[i]; ++i) {
    std::error_code error;
    const auto size = fs::file_size(files[i], error);
    if (!error) stored += static_cast<double>(size);
  }
  CSLDestroy(files);
  // blocks larger than the image hold nothing in what is larger
  const double most = block > pixels ? most_beside(stored) : most_pixels(stored);
  if (bytes <= most) return;
  std::ostringstream text;
  text << path.string() << ": " << size_text(d) << (block > pixels ? " in blocks of " : ", ")
       << memory_text(bytes) << ", in a file of " << static_cast<long long>(stored)
       << " bytes, expected ";
  if (block > pixels)
    text << "at most " << memory_text(most);
  else
    text << "at least a byte for every " << static_cast<int>(kMostPacked);
  text << "; empty or damaged?";
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

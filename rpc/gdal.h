// SPDX-License-Identifier: Apache-2.0
#pragma once

// For rpc/read*.cpp and rpc/raster.cpp only: no public header names GDAL.

#include "satsurf/core/error.h"
#include "satsurf/rpc/read.h"

#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <cpl_conv.h>
#include <cpl_error.h>
#include <cpl_string.h>
#include <gdal_priv.h>

namespace satsurf::rpc {

/// While one lives, this thread's GDAL prints nothing, keeps its last error for gdal_error(), and
/// neither reads nor leaves .aux.xml files. What the caller had set is restored.
class GdalScope {
 public:
  GdalScope() {
    static const bool registered = (GDALAllRegister(), true);
    static_cast<void>(registered);
    if (const char* old = CPLGetThreadLocalConfigOption(kPam, nullptr)) pam_ = old;
    CPLSetThreadLocalConfigOption(kPam, "NO");
    CPLPushErrorHandler(CPLQuietErrorHandler);
    CPLErrorReset();
  }
  ~GdalScope() {
    CPLPopErrorHandler();
    CPLSetThreadLocalConfigOption(kPam, pam_ ? pam_->c_str() : nullptr);
  }
  GdalScope(const GdalScope&) = delete;
  GdalScope& operator=(const GdalScope&) = delete;

 private:
  static constexpr const char* kPam = "GDAL_PAM_ENABLED";
  std::optional<std::string> pam_;
};

/// GDAL's last message on one line.
inline std::string gdal_error() {
  std::string text = CPLGetLastErrorMsg();
  for (char& c : text)
    if (c == '\n' || c == '\r') c = ' ';
  while (!text.empty() && text.back() == ' ') text.pop_back();
  return text.empty() ? "no reason given" : text;
}

struct DatasetCloser {
  void operator()(GDALDataset* d) const { GDALClose(GDALDataset::ToHandle(d)); }
};
using DatasetPtr = std::unique_ptr<GDALDataset, DatasetCloser>;

/// throws IoError naming the file; needs a GdalScope
inline DatasetPtr open_raster(const std::filesystem::path& path) {
  const std::string name = path.string();
  if (!name.starts_with("/vsi") && !std::filesystem::exists(path))
    throw IoError(name + ": no such file, expected a raster");
  const unsigned flags = GDAL_OF_RASTER | GDAL_OF_READONLY | GDAL_OF_VERBOSE_ERROR;
  DatasetPtr d(GDALDataset::FromHandle(GDALOpenEx(name.c_str(), flags, nullptr, nullptr, nullptr)));
  if (!d)
    throw IoError(name + ": not a raster that can be read, expected GeoTIFF, NITF or alike; " +
                  gdal_error());
  if (d->GetRasterCount() == 0)
    throw IoError(name +
                  ": holds no bands of its own, expected an image; name one of its subdatasets");
  return d;
}

inline std::map<std::string, std::string> metadata_of(GDALDataset& d, const char* domain) {
  std::map<std::string, std::string> items;
  char** list = d.GetMetadata(domain);
  for (int i = 0; list && list[i]; ++i) {
    const std::string_view item = list[i];
    if (const auto cut = item.find('='); cut != std::string_view::npos)
      items.emplace(item.substr(0, cut), item.substr(cut + 1));
  }
  return items;
}

/// "+005124.00 pixels" -> 5124: a finite number, alone or followed by blanks and a unit; in any
/// locale.
inline std::optional<double> parse_number(std::string_view text) {
  const auto begin = text.find_first_not_of(" \t\r\n");
  if (begin == std::string_view::npos) return std::nullopt;
  const std::string s(text.substr(begin));
  char* end = nullptr;
  const double value = CPLStrtod(s.c_str(), &end);
  const bool ends =
      end != s.c_str() && (*end == '\0' || *end == ' ' || *end == '\t' || *end == '\r');
  if (!ends || !(value >= -1e300 && value <= 1e300)) return std::nullopt;
  return value;
}

/// Bands without the alpha band, counted from 1.
std::vector<int> colour_bands(GDALDataset& d);

/// What read_info() says, of an open file.
/// throws  IoError
RasterInfo info_of(const std::filesystem::path& path, GDALDataset& d);

}  // namespace satsurf::rpc

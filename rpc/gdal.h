// SPDX-License-Identifier: Apache-2.0
#pragma once

// For the readers and writers of rpc/ only: no public header names GDAL.

#include "satsurf/core/error.h"
#include "satsurf/core/files.h"
#include "satsurf/rpc/raster.h"
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
/// neither reads nor leaves .aux.xml files, and opens no remote ones. What the caller had set is
/// restored.
class GdalScope {
 public:
  GdalScope() {
    static const bool registered = (GDALAllRegister(), true);
    static_cast<void>(registered);
    if (const char* old = CPLGetThreadLocalConfigOption(kPam, nullptr)) pam_ = old;
    CPLSetThreadLocalConfigOption(kPam, "NO");
    if (const char* old = CPLGetThreadLocalConfigOption(kRemote, nullptr)) remote_ = old;
    CPLSetThreadLocalConfigOption(kRemote, "none");
    CPLPushErrorHandler(CPLQuietErrorHandler);
    CPLErrorReset();
  }
  ~GdalScope() {
    CPLPopErrorHandler();
    CPLSetThreadLocalConfigOption(kPam, pam_ ? pam_->c_str() : nullptr);
    CPLSetThreadLocalConfigOption(kRemote, remote_ ? remote_->c_str() : nullptr);
  }
  GdalScope(const GdalScope&) = delete;
  GdalScope& operator=(const GdalScope&) = delete;

 private:
  static constexpr const char* kPam = "GDAL_PAM_ENABLED";
  /// The one remote file that may be opened.
  static constexpr const char* kRemote = "CPL_VSIL_CURL_ALLOWED_FILENAME";
  std::optional<std::string> pam_, remote_;
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

/// Opens a raster of one of the known formats or of those that `trusted_drivers` names. Nothing is
/// asked of a network: names in GDAL's virtual file systems are refused, and so is a VRT whose
/// sources are not files of such formats.
/// Needs a GdalScope.
/// throws  IoError naming the file
DatasetPtr open_raster(const std::filesystem::path& path);

/// Refuses a raster whose pixels cannot be in its file: one of some hundred bytes may claim any
/// size, or blocks larger than itself, which are read whole. Up to 256 MiB are never refused, nor up
/// to 100000 bytes for each of the file.
/// throws  IoError
void check_content(const std::filesystem::path& path, GDALDataset& d);
/// Refuses what the memory cannot hold: some systems promise any amount.
/// needed  bytes, beside those of a block
/// throws  IoError
void check_memory(const std::filesystem::path& path, GDALDataset& d, double needed);

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

/// A raster of bare values in a file of its own, for one that is written bit by bit and read once: its
/// room is taken at the beginning, and a write that fails is an error and no more. A GeoTIFF that a
/// full disk has cut off is read again by libtiff 4.5 while it is closed, which may crash.
/// path    what the values are to become, for messages
/// file    of the values
/// throws  IoError
DatasetPtr bare_raster(const std::filesystem::path& path, const std::filesystem::path& file,
                       Index bands, Index height, Index width, GDALDataType type);

/// Makes the cloud-optimised GeoTIFF of a finished raster, which takes its place at once.
/// means   whether a mean of cells means something: overviews
/// throws  IoError
void write_cog(const std::filesystem::path& path, GDALDataset& from, bool means);

/// Whether a raster itself says where it lies.
bool has_place(GDALDataset& d);
/// The grid of a raster in a projected system: its own, or DFC2019's in the text file beside it.
/// zone    of a raster that names no system
/// throws  IoError for one without a place, in degrees, of other than square cells or not north up
GeoGrid grid_of(const std::filesystem::path& path, GDALDataset& d,
                const std::optional<UtmZone>& zone);

/// How many cells of a raster become one of another grid.
enum class Sampled { nearest, lowest, highest };
/// The first band of a raster on another grid, NaN where it says nothing.
/// crs     of the raster
/// grid    in a zone of UTM
/// throws  Error where PROJ knows no way between the systems
Tensor first_band_on(GDALDataset& d, const OGRSpatialReference& crs, const GeoGrid& grid,
                     Index height, Index width, Sampled how);

/// Whether a file is of one of the vector formats that are read.
bool is_vector_file(const std::filesystem::path& path);

/// What read_info() says, of an open file.
/// throws  IoError
RasterInfo info_of(const std::filesystem::path& path, GDALDataset& d);

}  // namespace satsurf::rpc

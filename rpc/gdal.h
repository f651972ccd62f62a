// SPDX-License-Identifier: Apache-2.0
#pragma once

// For the readers and writers of rpc/ only: no public header names GDAL.

#include "satsurf/core/error.h"
#include "satsurf/core/files.h"
#include "satsurf/rpc/raster.h"
#include "satsurf/rpc/read.h"

#include <array>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <system_error>
#include <utility>
#include <vector>

#include <cpl_conv.h>
#include <cpl_error.h>
#include <cpl_minixml.h>
#include <cpl_string.h>
#include <cpl_vsi.h>
#include <gdal_priv.h>

namespace satsurf::rpc {

/// While one lives, this thread's GDAL prints nothing, keeps its last error for gdal_error(), and
/// neither reads nor leaves .aux.xml files; whatever a file names, it asks nothing of a network and
/// opens no pipe, no device and nothing that `claim_of` refuses. What the caller had set is restored.
class GdalScope {
 public:
  GdalScope();
  ~GdalScope();
  GdalScope(const GdalScope&) = delete;
  GdalScope& operator=(const GdalScope&) = delete;

 private:
  std::vector<std::pair<const char*, std::optional<std::string>>> before_;  ///< options
};

/// Refuses a file for which GDAL would have asked a network or believed a false claim, in this thread's
/// outermost GdalScope.
/// path    of the file that is read
/// throws  IoError
void check_refused(const std::filesystem::path& path);

/// What a file says of itself for which GDAL takes memory before it sees whether that can be true.
struct FileClaim {
  std::string refusal;  ///< what is wrong with it, if anything is
  std::optional<Index>
      threads;  ///< how many may decode it at once, where each takes memory of its own
};
/// Looks at the tiles of a JPEG 2000 and the size of a BMP.
/// name  of a file on this machine, of any format
FileClaim claim_of(const std::string& name);

/// Whether a file on this machine is a JPEG 2000.
bool is_jpeg2000(const std::string& name);

/// Registers the drivers for what is read and written here and no others; once.
void register_drivers();
/// The drivers that may open rasters and vector files: those known here, and those of
/// `trusted_drivers`.
std::vector<std::string> raster_drivers();
std::vector<std::string> vector_drivers();
/// The driver that would open a file, by its beginning, whether it may or not; empty if none would.
/// kind  GDAL_OF_RASTER or GDAL_OF_VECTOR
std::string format_of(const std::string& name, unsigned kind = GDAL_OF_RASTER);
/// How the user can let a driver open files, to end a complaint; nothing for one without a name.
std::string allow_text(const std::string& driver);

/// A list as GDAL takes them, ended by a null pointer. The texts stay with their owner.
std::vector<const char*> list_of(const std::vector<std::string>& texts);
std::vector<const char*> list_of(std::vector<std::string>&& texts) =
    delete;  // it would point at nothing

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

/// A name for a file of GDAL's in memory; what was written there goes with it.
class MemoryFile {
 public:
  /// ending  of the name
  explicit MemoryFile(const std::string& ending = "");
  ~MemoryFile() { VSIUnlink(name_.c_str()); }
  MemoryFile(const MemoryFile&) = delete;
  MemoryFile& operator=(const MemoryFile&) = delete;

  const std::string& name() const { return name_; }
  /// What was written, as long as this lives; nothing if there is no such file.
  std::optional<std::string_view> bytes() const;

 private:
  std::string name_;
};

struct XmlDeleter {
  void operator()(CPLXMLNode* node) const { CPLDestroyXMLNode(node); }
};
using XmlPtr = std::unique_ptr<CPLXMLNode, XmlDeleter>;

/// Opens a raster of one of the known formats or of those that `trusted_drivers` names. Nothing is
/// asked of a network: names in GDAL's virtual file systems are refused, and so is a VRT whose
/// sources are not files of such formats.
/// Needs a GdalScope.
/// throws  IoError naming the file
DatasetPtr open_raster(const std::filesystem::path& path);

/// Refuses a raster of a format that may not be opened, and one that names what is no file here where
/// GDAL could not be kept from it. Needs a GdalScope.
/// throws  IoError
void check_format(const std::filesystem::path& path);

/// Bytes of pixels for each of a file's; and what needs so little memory that it is not worth a refusal.
constexpr double kMostPacked = 20'000, kLittlePixels = 16.0 * (1 << 20);
/// How many bytes of pixels a file can hold, however it packs them. DEFLATE packs 1000 equal bytes into
/// one. ZSTD and LZMA make some 50 bytes of a tile of 1 MiB of them, whose place in the file takes 16
/// more; sparse files leave out whole tiles.
/// stored  bytes of the file
constexpr double most_pixels(double stored) {
  return stored * kMostPacked > kLittlePixels ? stored * kMostPacked : kLittlePixels;
}
/// How many bytes of memory, beside its pixels, a file is worth.
/// stored  bytes of the file
constexpr double most_beside(double stored) { return 64e6 + 20 * stored; }

/// Refuses a raster whose pixels cannot be in its file: one of some hundred bytes may claim any
/// size, or blocks larger than the image, which are read whole. Up to 16 MiB are never refused, nor up to
/// 20000 bytes for each of the file, or 64 MB and 20 for each where blocks are larger than the image.
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

/// A file that goes with this, if it lies there still.
class TemporaryFile {
 public:
  explicit TemporaryFile(std::filesystem::path path) : path_(std::move(path)) {}
  ~TemporaryFile() {
    std::error_code ignored;
    std::filesystem::remove(path_, ignored);
  }
  TemporaryFile(const TemporaryFile&) = delete;
  TemporaryFile& operator=(const TemporaryFile&) = delete;

  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

/// A raster of bare values in a file of its own, for one that is written bit by bit and read once: its
/// room is taken at the beginning, and a write that fails is an error and no more. A GeoTIFF that a
/// full disk has cut off is read again by libtiff 4.5 while it is closed, which may crash.
/// path    what the values are to become, for messages
/// file    of the values
/// throws  IoError
DatasetPtr bare_raster(const std::filesystem::path& path, const std::filesystem::path& file,
                       Index bands, Index height, Index width, GDALDataType type);

/// Makes the cloud-optimised GeoTIFF of a finished raster, which takes its place at once, when it is on
/// the disk.
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

/// Heights above the WGS84 ellipsoid of points that have one height in a vertical system.
/// lon_lat  degrees on WGS84, one pair for each result
/// height   of all of them in the vertical system
/// returns  m; nothing where PROJ has no grid of the system there
/// throws   IoError where PROJ lacks its database
std::optional<std::vector<double>> above_ellipsoid(
    const OGRSpatialReference& up, const std::vector<std::array<double, 2>>& lon_lat,
    double height);

/// A system in the words of OGC.
/// form  WKT2_2019 or another of GDAL's names; null for the one that GDAL prefers
std::string wkt_of(const OGRSpatialReference& crs, const char* form);

/// Whether a file is of one of the vector formats that are read.
bool is_vector_file(const std::filesystem::path& path);

/// What read_info() says, of an open file.
/// throws  IoError
RasterInfo info_of(const std::filesystem::path& path, GDALDataset& d);

}  // namespace satsurf::rpc

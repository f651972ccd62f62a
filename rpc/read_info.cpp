// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/files.h"
#include "satsurf/rpc/camera_check.h"
#include "satsurf/rpc/gdal.h"
#include "satsurf/rpc/read.h"

#include <algorithm>
#include <cctype>

namespace satsurf::rpc {
namespace {

namespace fs = std::filesystem;

std::string upper(std::string text) {
  for (char& c : text) c = static_cast<char>(std::toupper(static_cast<unsigned char>(c)));
  return text;
}

std::string dtype_name(GDALDataType type) {
  switch (type) {
    case GDT_Byte:
      return "uint8";
    case GDT_UInt16:
      return "uint16";
    case GDT_Int16:
      return "int16";
    case GDT_Float32:
      return "float32";
    default:
      break;
  }
  std::string name = GDALGetDataTypeName(type);
  for (char& c : name) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return name;
}

/// A file beside the image that may hold its camera.
struct Sidecar {
  std::string name;
  const char* source;
  const char* mark;  ///< a word of such a file, where the name alone does not tell
};

/// Where a camera is looked for, best first.
std::vector<Sidecar> sidecars_of(const fs::path& path) {
  const std::string stem = path.stem().string();
  std::vector<Sidecar> out{{stem + ".RPB", "RPB", ""},
                           {stem + ".XML", "Maxar XML", "<RPB>"},
                           {stem + "_RPC.TXT", "_RPC.TXT", ""},
                           {stem + "_rpc.txt", "_RPC.TXT", ""},
                           {stem + ".rpc", ".rpc file", ""},
                           {path.filename().string() + ".aux.xml", ".aux.xml", "\"RPC\""},
                           {"RPC_" + stem + ".XML", "DIMAP", "<Global_RFM>"}};
  for (const char* prefix : {"IMG_", "DIM_"})
    if (stem.starts_with(prefix)) {
      std::string rest = stem.substr(4);
      // The tiles of a DIMAP image, IMG_..._R1C1, share one camera, which GDAL moves to the tile;
      // the first needs no moving.
      if (rest.ends_with("_R1C1")) rest.resize(rest.size() - 5);
      out.push_back({"RPC_" + rest + ".XML", "DIMAP", "<Global_RFM>"});
    }
  return out;
}

bool mentions(const fs::path& file, const char* word) {
  // GDAL lists files, too, that it would make
  return is_file(file) && read_text_file(file, "a camera file").find(word) != std::string::npos;
}

/// The files GDAL reads of an image: those that are on the disk, each once, the image first.
std::vector<fs::path> files_of(const fs::path& path, GDALDataset& d) {
  std::vector<fs::path> out;
  if (is_file(path)) out.push_back(path);
  char** files = d.GetFileList();
  for (int i = 0; files && files[i]; ++i)
    if (is_file(files[i]) && std::find(out.begin(), out.end(), fs::path(files[i])) == out.end())
      out.emplace_back(files[i]);
  CSLDestroy(files);
  return out;
}

/// Which of its files GDAL took the camera from.
std::string gdal_rpc_source(GDALDataset& d) {
  std::string source;
  int best = 99;
  const auto found = [&](const char* name, int rank) {
    if (rank < best) best = rank, source = name;
  };
  char** files = d.GetFileList();
  for (int i = 0; files && files[i]; ++i) {
    const fs::path file = files[i];
    const std::string name = upper(file.filename().string());
    if (name.ends_with(".RPB"))
      found("RPB", 0);
    else if (name.ends_with("_RPC.TXT"))
      found("_RPC.TXT", 2);
    else if (name.ends_with(".XML") && mentions(file, "<RPB>"))
      found("Maxar XML", 1);
    else if (name.ends_with(".XML") && mentions(file, "<Global_RFM>"))
      found("DIMAP", 3);
    else if (name.ends_with(".RPC"))
      found(".rpc file", 4);
  }
  CSLDestroy(files);
  if (!source.empty()) return source;
  const std::string driver = d.GetDriver() ? d.GetDriverName() : "";
  return driver == "GTiff" ? "TIFF tag" : driver;
}

/// The camera GDAL offers (of GeoTIFF, NITF and a few more), else one in a file beside the image.
void find_camera(RasterInfo& info, GDALDataset& d) {
  const auto sidecars = sidecars_of(info.path);
  for (const Sidecar& s : sidecars) info.tried.push_back(s.name);
  info.tried.push_back("the TIFF tag or NITF RPC00B of the file itself");
  if (const auto items = metadata_of(d, "RPC"); !items.empty()) {
    info.rpc = rpc_from_gdal_metadata(items, info.path.string());
    info.rpc_source = gdal_rpc_source(d);
    return;
  }
  for (const Sidecar& s : sidecars) {
    const fs::path file = info.path.parent_path() / s.name;
    if (!is_file(file) || !mentions(file, s.mark)) continue;
    info.rpc = read_rpc_file(file);
    info.rpc_source = s.source;
    if (std::find(info.files.begin(), info.files.end(), file) == info.files.end())
      info.files.push_back(file);
    return;
  }
}

/// The first item whose key is one of `keys`; a key that begins with '*' is a suffix. Keys without
/// case.
std::optional<std::string> find_item(const std::vector<std::map<std::string, std::string>>& domains,
                                     const std::vector<std::string>& keys) {
  for (const std::string& key : keys)
    for (const auto& items : domains)
      for (const auto& [name, value] : items)
        if (key[0] == '*' ? upper(name).ends_with(key.substr(1)) : upper(name) == key) return value;
  return std::nullopt;
}

std::optional<double> find_number(const std::vector<std::map<std::string, std::string>>& domains,
                                  const std::vector<std::string>& keys) {
  const auto text = find_item(domains, keys);
  return text ? parse_number(*text) : std::nullopt;
}

/// Channels that are red, green and blue: as the bands say themselves, else as Maxar delivers 4
/// bands (B G R N) and 8 bands (C B G Y R RE N N2), else the first three.
std::array<Index, 3> rgb_channels(GDALDataset& d, const std::vector<int>& bands,
                                  const std::map<std::string, std::string>& imd) {
  std::array<Index, 3> rgb{-1, -1, -1};
  for (std::size_t c = 0; c < bands.size(); ++c) {
    const auto colour = d.GetRasterBand(bands[c])->GetColorInterpretation();
    if (colour == GCI_RedBand) rgb[0] = static_cast<Index>(c);
    if (colour == GCI_GreenBand) rgb[1] = static_cast<Index>(c);
    if (colour == GCI_BlueBand) rgb[2] = static_cast<Index>(c);
  }
  if (rgb[0] >= 0 && rgb[1] >= 0 && rgb[2] >= 0) return rgb;
  const auto has_group = [&](const std::string& group) {
    return std::any_of(imd.begin(), imd.end(), [&](const auto& item) {
      return upper(item.first).starts_with(group + ".");
    });
  };
  if (bands.size() == 4 && has_group("BAND_B") && has_group("BAND_R")) return {2, 1, 0};
  if (bands.size() == 8 && has_group("BAND_C") && has_group("BAND_R")) return {4, 2, 1};
  return {0, 1, 2};
}

}  // namespace

std::vector<int> colour_bands(GDALDataset& d) {
  std::vector<int> bands;
  for (int b = 1; b <= d.GetRasterCount(); ++b)
    if (d.GetRasterBand(b)->GetColorInterpretation() != GCI_AlphaBand) bands.push_back(b);
  return bands;
}

RasterInfo info_of(const fs::path& path, GDALDataset& d) {
  RasterInfo info;
  info.path = path;
  info.width = d.GetRasterXSize();
  info.height = d.GetRasterYSize();
  const std::vector<int> bands = colour_bands(d);
  if (bands.empty())
    throw IoError(path.string() + ": holds an alpha band alone, expected an image");
  info.bands = static_cast<Index>(bands.size());
  GDALRasterBand* first = d.GetRasterBand(bands[0]);
  info.dtype = dtype_name(first->GetRasterDataType());
  if (GDALDataTypeIsComplex(first->GetRasterDataType()))
    throw IoError(path.string() + ": pixels are complex (" + info.dtype +
                  "), expected real numbers");

  info.files = files_of(path, d);
  find_camera(info, d);
  const std::vector<std::map<std::string, std::string>> domains{
      metadata_of(d, ""), metadata_of(d, "IMD"), metadata_of(d, "IMAGERY")};
  info.sun_elevation_deg =
      find_number(domains, {"SUN_ELEVATION", "*MEANSUNEL", "NITF_USE00A_SUN_EL"});
  info.sun_azimuth_deg = find_number(domains, {"SUN_AZIMUTH", "*MEANSUNAZ", "NITF_USE00A_SUN_AZ"});
  info.acquisition_date =
      find_item(domains, {"ACQUISITION_DATE", "ACQUISITIONDATETIME", "*FIRSTLINETIME",
                          "NITF_STDIDC_ACQUISITION_DATE", "NITF_IDATIM"});
  const auto low = find_number(domains, {"MIN_ALT"}), high = find_number(domains, {"MAX_ALT"});
  if (low && high && *low < *high && on_earth({*low, *high}))
    info.height_range = HeightRange{*low, *high};

  int has_nodata = 0;
  const double nodata = first->GetNoDataValue(&has_nodata);
  if (has_nodata) info.nodata = nodata;
  std::array<double, 6> transform{};
  // A camera's image in the contest files carries the identity, which says nothing.
  if (d.GetGeoTransform(transform.data()) == CE_None &&
      transform != std::array<double, 6>{0, 1, 0, 0, 0, 1})
    info.geotransform = transform;
  const OGRSpatialReference* crs = d.GetSpatialRef();
  if (crs != nullptr && crs->IsLocal()) {
    const char* name = crs->GetName();
    info.local_crs = name == nullptr ? "unnamed" : name;
  } else if (crs != nullptr) {
    const char* code = crs->GetAuthorityCode(nullptr);
    info.crs = code ? std::string("EPSG:") + code : wkt_of(*crs, nullptr);
  }
  info.rgb_channels = rgb_channels(d, bands, domains[1]);
  return info;
}

void check_pixels(const fs::path& path) {
  constexpr double kMostPixels = 1e8;
  const GdalScope scope;
  // else the rest of a JPEG that was cut off is grey
  const CPLConfigOptionSetter strict("GDAL_ERROR_ON_LIBJPEG_WARNING", "YES", true);
  const DatasetPtr d = open_raster(path);
  check_content(path, *d);
  const int width = d->GetRasterXSize(), height = d->GetRasterYSize();
  std::vector<int> bands = colour_bands(*d);
  const bool all = static_cast<double>(width) * static_cast<double>(height) <= kMostPixels;
  int block_width = 0, block_height = 0;
  if (!bands.empty()) d->GetRasterBand(bands[0])->GetBlockSize(&block_width, &block_height);
  // Whole blocks at a time, as far as they take little memory.
  constexpr double kMostValues = 16e6;
  const double row = static_cast<double>(width) * static_cast<double>(bands.size());
  const int rows =
      std::clamp(std::min(block_height, static_cast<int>(kMostValues / row)), 1, height);
  std::vector<float> pixels(bands.size() * static_cast<std::size_t>(width) *
                            static_cast<std::size_t>(all ? rows : 1));
  for (int y = all ? 0 : height - 1; y < height; y += rows) {
    const int n = all ? std::min(rows, height - y) : 1;
    CPLErrorReset();
    if (d->RasterIO(GF_Read, 0, y, width, n, pixels.data(), width, n, GDT_Float32,
                    static_cast<int>(bands.size()), bands.data(), 0, 0, 0, nullptr) != CE_None)
      throw IoError(path.string() + ": the pixels cannot be read from row " + std::to_string(y) +
                    " on, expected a whole file; " + gdal_error());
  }
}

RasterInfo read_info(const fs::path& path) {
  const GdalScope scope;
  const DatasetPtr d = open_raster(path);
  return info_of(path, *d);
}

}  // namespace satsurf::rpc

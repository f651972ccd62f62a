// SPDX-License-Identifier: Apache-2.0
#include "satsurf/rpc/raster.h"

#include "satsurf/core/atomic_file.h"
#include "satsurf/rpc/gdal.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <fstream>
#include <limits>
#include <sstream>

#include <cpl_vsi.h>
#include <ogr_spatialref.h>

namespace satsurf::rpc {
namespace {

namespace fs = std::filesystem;

std::string digits(double value) {
  char text[40];
  std::snprintf(text, sizeof text, "%.17g", value);
  return text;
}

/// A GeoTIFF built in memory, so that the disk only ever sees the finished file.
class MemoryTiff {
 public:
  MemoryTiff(const fs::path& path, int width, int height, int bands, GDALDataType type,
             const std::vector<const char*>& options)
      : path_(path) {
    static std::atomic<unsigned> count{0};
    name_ = "/vsimem/satsurf_" + std::to_string(count++) + ".tif";
    char** list = nullptr;
    for (const char* o : options) list = CSLAddString(list, o);
    GDALDriver* driver = GetGDALDriverManager()->GetDriverByName("GTiff");
    if (driver) dataset_.reset(driver->Create(name_.c_str(), width, height, bands, type, list));
    CSLDestroy(list);
    if (!dataset_) fail();
  }
  ~MemoryTiff() {
    dataset_.reset();
    VSIUnlink(name_.c_str());
  }
  MemoryTiff(const MemoryTiff&) = delete;
  MemoryTiff& operator=(const MemoryTiff&) = delete;

  GDALDataset* operator->() { return dataset_.get(); }
  void check(CPLErr result) const {
    if (result != CE_None) fail();
  }
  /// Finishes the file and puts it in its place.
  void save() {
    CPLErrorReset();
    dataset_.reset();
    if (CPLGetLastErrorType() >= CE_Failure) fail();
    vsi_l_offset size = 0;
    const auto* bytes = VSIGetMemFileBuffer(name_.c_str(), &size, FALSE);
    if (!bytes) fail();
    atomic_write(path_, std::string_view(reinterpret_cast<const char*>(bytes),
                                         static_cast<std::size_t>(size)));
  }

 private:
  [[noreturn]] void fail() const {
    throw IoError(path_.string() + ": the GeoTIFF cannot be made; " + gdal_error());
  }
  fs::path path_;
  std::string name_;
  DatasetPtr dataset_;
};

struct Extents {
  Index C, H, W;
};
Extents extents_of(const char* where, const Tensor& values, bool planes_only) {
  const Shape& s = values.shape();
  const bool planes = s.rank() == 3;
  if (values.empty() || !(planes || (s.rank() == 2 && !planes_only)) || s.count() == 0)
    throw ShapeError(std::string(where) + ": values " + (values.empty() ? "[]" : s.str()) +
                     ", expected " + (planes_only ? "[C H W]" : "[H W] or [C H W]"));
  return planes ? Extents{s[0], s[1], s[2]} : Extents{1, s[0], s[1]};
}

OGRSpatialReference system_of(int epsg) {
  OGRSpatialReference crs;
  if (crs.importFromEPSG(epsg) != OGRERR_NONE)
    throw Error("EPSG:" + std::to_string(epsg) +
                ": not a known reference system, expected a projected one");
  crs.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
  return crs;
}

int epsg_of(const OGRSpatialReference& crs) {
  const auto code = [](const OGRSpatialReference& c) {
    const char* text = c.GetAuthorityCode("PROJCS");
    return text ? std::atoi(text) : 0;
  };
  if (const int direct = code(crs)) return direct;
  OGRSpatialReference guess(crs);
  return guess.AutoIdentifyEPSG() == OGRERR_NONE ? code(guess) : 0;
}

/// NAME_DSM.tif, NAME_CLS.tif -> NAME_DSM.txt
fs::path dfc_grid_path(const fs::path& path) {
  std::string stem = path.stem().string();
  if (stem.ends_with("_CLS")) stem.replace(stem.size() - 4, 4, "_DSM");
  return path.parent_path() / (stem + ".txt");
}

GeoGrid read_dfc_grid(const fs::path& path, const fs::path& text_path, Index width, Index height,
                      const std::optional<UtmZone>& zone) {
  std::ifstream text(text_path);
  if (!text)
    throw IoError(path.string() + ": no georeference, expected one in the file or in " +
                  text_path.string());
  std::vector<double> numbers;
  for (std::string word; text >> word;)
    if (const auto v = parse_number(word))
      numbers.push_back(*v);
    else
      throw IoError(text_path.string() + ": '" + word + "', expected a number");
  if (numbers.size() != 4)
    throw IoError(text_path.string() + ": " + std::to_string(numbers.size()) +
                  " numbers, expected 4: easting and northing of the lower-left corner, cells per "
                  "side, metres per cell");
  const double cells = numbers[2], step = numbers[3];
  if (!(step > 0) || cells != static_cast<double>(width) || cells != static_cast<double>(height)) {
    std::ostringstream message;
    message << text_path.string() << ": " << cells << " cells per side of " << step << " m, but "
            << path.string() << " has " << width << " x " << height;
    throw IoError(message.str());
  }
  return {zone ? zone->epsg() : 0, numbers[0], numbers[1] + cells * step, step};
}

GeoGrid grid_of(const fs::path& path, GDALDataset& d, const std::optional<UtmZone>& zone) {
  std::array<double, 6> t{};
  const bool placed = d.GetGeoTransform(t.data()) == CE_None;
  if (!placed || t == std::array<double, 6>{0, 1, 0, 0, 0, 1})
    return read_dfc_grid(path, dfc_grid_path(path), d.GetRasterXSize(), d.GetRasterYSize(), zone);
  const double step = t[1];
  if (t[2] != 0 || t[4] != 0 || !(step > 0) || !(std::abs(t[5] + step) <= 1e-6 * step)) {
    std::ostringstream text;
    text << path.string() << ": cells of (" << t[1] << ", " << t[2] << "; " << t[4] << ", " << t[5]
         << "), expected square ones with north up; warp it first (gdalwarp)";
    throw IoError(text.str());
  }
  int epsg = zone ? zone->epsg() : 0;
  if (const OGRSpatialReference* crs = d.GetSpatialRef()) {
    if (crs->IsGeographic())
      throw IoError(
          path.string() +
          ": coordinates in degrees, expected a projected system in metres; warp it first "
          "(gdalwarp)");
    epsg = epsg_of(*crs);
  }
  return {epsg, t[0], t[3], step};
}

}  // namespace

GeoTags ellipsoidal_height(const std::string& description) {
  return {"m", description, {}, {{"VERTICAL_DATUM", "WGS84 ellipsoid"}}};
}

void write_geo_raster(const fs::path& path, const Tensor& values, const GeoGrid& grid,
                      const GeoTags& tags) {
  const auto [C, H, W] = extents_of("write_geo_raster", values, false);
  if (!(grid.step > 0))
    throw Error("write_geo_raster: cells of " + digits(grid.step) + " m, expected a positive size");
  if (!tags.band_names.empty() && static_cast<Index>(tags.band_names.size()) != C)
    throw Error("write_geo_raster: " + std::to_string(tags.band_names.size()) +
                " band names, expected " + std::to_string(C));
  const GdalScope scope;
  const auto w = static_cast<int>(W), h = static_cast<int>(H);
  MemoryTiff tiff(
      path, w, h, static_cast<int>(C), GDT_Float32,
      {"TILED=YES", "COMPRESS=DEFLATE", "PREDICTOR=3", "INTERLEAVE=BAND", "BIGTIFF=IF_SAFER"});
  if (grid.epsg != 0) {
    const OGRSpatialReference crs = system_of(grid.epsg);
    tiff.check(tiff->SetSpatialRef(&crs));
  }
  std::array<double, 6> transform{grid.x0, grid.step, 0, grid.y0, 0, -grid.step};
  tiff.check(tiff->SetGeoTransform(transform.data()));
  tiff.check(tiff->SetMetadataItem("AREA_OR_POINT", "Area"));
  if (!tags.description.empty())
    tiff.check(tiff->SetMetadataItem("TIFFTAG_IMAGEDESCRIPTION", tags.description.c_str()));
  for (const auto& [key, value] : tags.metadata)
    tiff.check(tiff->SetMetadataItem(key.c_str(), value.c_str()));

  std::vector<float> plane(static_cast<std::size_t>(H * W));
  for (Index c = 0; c < C; ++c) {
    GDALRasterBand* band = tiff->GetRasterBand(static_cast<int>(c) + 1);
    tiff.check(band->SetNoDataValue(static_cast<double>(kNodata)));
    if (!tags.unit.empty()) tiff.check(band->SetUnitType(tags.unit.c_str()));
    if (!tags.band_names.empty())
      band->SetDescription(tags.band_names[static_cast<std::size_t>(c)].c_str());
    const float* from = values.data() + c * H * W;
    std::transform(from, from + H * W, plane.begin(),
                   [](float v) { return std::isfinite(v) ? v : kNodata; });
    tiff.check(
        band->RasterIO(GF_Write, 0, 0, w, h, plane.data(), w, h, GDT_Float32, 0, 0, nullptr));
  }
  tiff.save();
}

GeoRaster read_geo_raster(const fs::path& path, const std::optional<UtmZone>& zone) {
  const GdalScope scope;
  const DatasetPtr d = open_raster(path);
  GeoRaster out;
  out.grid = grid_of(path, *d, zone);
  const int w = d->GetRasterXSize(), h = d->GetRasterYSize(), bands = d->GetRasterCount();
  const Index H = h, W = w, C = bands;
  out.values = Tensor::uninitialised(C == 1 ? Shape{H, W} : Shape{C, H, W});
  for (int b = 1; b <= bands; ++b) {
    GDALRasterBand* band = d->GetRasterBand(b);
    float* to = out.values.data() + (b - 1) * H * W;
    CPLErrorReset();
    if (band->RasterIO(GF_Read, 0, 0, w, h, to, w, h, GDT_Float32, 0, 0, nullptr) != CE_None)
      throw IoError(path.string() + ": the values cannot be read, expected a whole file; " +
                    gdal_error());
    int has_nodata = 0;
    const auto nodata = static_cast<float>(band->GetNoDataValue(&has_nodata));
    constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
    for (float* v = to; v != to + H * W; ++v)
      if ((has_nodata && *v == nodata) || !std::isfinite(*v)) *v = kNan;
    if (const std::string name = band->GetDescription(); !name.empty())
      out.tags.band_names.push_back(name);
  }
  if (static_cast<int>(out.tags.band_names.size()) != bands) out.tags.band_names.clear();
  out.tags.unit = d->GetRasterBand(1)->GetUnitType();
  out.tags.metadata = metadata_of(*d, "");
  if (const auto text = out.tags.metadata.extract("TIFFTAG_IMAGEDESCRIPTION"))
    out.tags.description = text.mapped();
  return out;
}

void write_dfc_grid(const fs::path& path, const GeoGrid& grid, Index size) {
  char text[200];
  std::snprintf(text, sizeof text, "%.6f\n%.6f\n%.6f\n%.6f\n", grid.x0,
                grid.y0 - static_cast<double>(size) * grid.step, static_cast<double>(size),
                grid.step);
  atomic_write(path, text);
}

void write_rpc_geotiff(const fs::path& path, const Tensor& pixels, PixelType type, const Rpc& rpc,
                       const std::map<std::string, std::string>& metadata) {
  const auto [C, H, W] = extents_of("write_rpc_geotiff", pixels, true);
  const GdalScope scope;
  const auto w = static_cast<int>(W), h = static_cast<int>(H), bands = static_cast<int>(C);
  const bool wide = type == PixelType::uint16;
  MemoryTiff tiff(path, w, h, bands, wide ? GDT_UInt16 : GDT_Byte,
                  {"TILED=YES", "COMPRESS=DEFLATE", "PREDICTOR=2", "INTERLEAVE=PIXEL",
                   "BIGTIFF=IF_SAFER", C == 3 ? "PHOTOMETRIC=RGB" : "PHOTOMETRIC=MINISBLACK"});
  char** items = nullptr;
  const auto add = [&](const char* key, const std::string& value) {
    items = CSLSetNameValue(items, key, value.c_str());
  };
  const auto add_list = [&](const char* key, const std::array<double, 20>& values) {
    std::string text;
    for (const double v : values) text += digits(v) + " ";
    add(key, text);
  };
  add("ERR_BIAS", "-1"), add("ERR_RAND", "-1");  // unknown
  add("LINE_OFF", digits(rpc.line_off)), add("SAMP_OFF", digits(rpc.samp_off));
  add("LAT_OFF", digits(rpc.lat_off)), add("LONG_OFF", digits(rpc.lon_off));
  add("HEIGHT_OFF", digits(rpc.height_off)), add("HEIGHT_SCALE", digits(rpc.height_scale));
  add("LINE_SCALE", digits(rpc.line_scale)), add("SAMP_SCALE", digits(rpc.samp_scale));
  add("LAT_SCALE", digits(rpc.lat_scale)), add("LONG_SCALE", digits(rpc.lon_scale));
  add_list("LINE_NUM_COEFF", rpc.line_num), add_list("LINE_DEN_COEFF", rpc.line_den);
  add_list("SAMP_NUM_COEFF", rpc.samp_num), add_list("SAMP_DEN_COEFF", rpc.samp_den);
  const CPLErr set = tiff->SetMetadata(items, "RPC");
  CSLDestroy(items);
  tiff.check(set);
  for (const auto& [key, value] : metadata)
    tiff.check(tiff->SetMetadataItem(key.c_str(), value.c_str()));

  const float top = wide ? 65535.0F : 255.0F;
  std::vector<std::uint16_t> whole(static_cast<std::size_t>(pixels.count()));
  std::transform(pixels.data(), pixels.data() + pixels.count(), whole.begin(), [&](float v) {
    return static_cast<std::uint16_t>(v > 0 ? std::lround(std::min(v, top)) : 0);  // NaN becomes 0
  });
  tiff.check(tiff->RasterIO(GF_Write, 0, 0, w, h, whole.data(), w, h, GDT_UInt16, bands, nullptr, 0,
                            0, 0, nullptr));
  tiff.save();
}

}  // namespace satsurf::rpc

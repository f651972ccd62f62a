// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/atomic_file.h"
#include "satsurf/rpc/crs.h"
#include "satsurf/rpc/gdal.h"
#include "satsurf/rpc/raster.h"

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <limits>
#include <memory>
#include <utility>

#include <fcntl.h>
#include <ogr_spatialref.h>

namespace satsurf::rpc {
namespace {

namespace fs = std::filesystem;

std::string digits(double value) {
  char text[40];
  std::snprintf(text, sizeof text, "%.17g", value);
  return text;
}

[[noreturn]] void refuse(const fs::path& path) {
  throw IoError(path.string() + ": the GeoTIFF cannot be made; " + gdal_error());
}

GDALDriver& driver_of_name(const fs::path& path, const char* name) {
  GDALDriver* found = GetGDALDriverManager()->GetDriverByName(name);
  if (!found) throw IoError(path.string() + ": this GDAL has no driver " + name + ", expected one");
  return *found;
}

/// A raster that is built in memory and leaves it as a finished file, so that the disk never sees a
/// part of one.
class MemoryRaster {
 public:
  /// driver  GTiff, which compresses while it is written, or MEM
  MemoryRaster(const fs::path& path, const char* driver, const std::array<int, 3>& size,
               GDALDataType type, const std::vector<const char*>& options = {})
      : path_(path) {
    CPLStringList list;
    for (const char* o : options) list.AddString(o);
    dataset_.reset(driver_of_name(path, driver)
                       .Create(file_.name().c_str(), size[0], size[1], size[2], type, list));
    if (!dataset_) refuse(path);
  }

  GDALDataset* operator->() { return dataset_.get(); }
  GDALDataset& operator*() { return *dataset_; }
  void check(CPLErr result) const {
    if (result != CE_None) refuse(path_);
  }
  /// Makes another format of it, which takes its place.
  void convert(const char* driver, const std::vector<const char*>& options) {
    CPLStringList list;
    for (const char* o : options) list.AddString(o);
    DatasetPtr other(
        driver_of_name(path_, driver)
            .CreateCopy(file_.name().c_str(), dataset_.get(), FALSE, list, nullptr, nullptr));
    if (!other) refuse(path_);
    dataset_ = std::move(other);
  }
  /// Finishes the file and puts it in its place.
  void save() {
    CPLErrorReset();
    dataset_.reset();
    if (CPLGetLastErrorType() >= CE_Failure) refuse(path_);
    const auto bytes = file_.bytes();
    if (!bytes) refuse(path_);
    atomic_write(path_, *bytes);
  }

 private:
  fs::path path_;
  MemoryFile file_{".tif"};  // before the dataset, which is closed first
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

OGRSpatialReference known_system(int epsg) {
  OGRSpatialReference crs;
  if (crs.importFromEPSG(epsg) != OGRERR_NONE)
    throw Error("EPSG:" + std::to_string(epsg) +
                ": not a known reference system, expected a projected one");
  crs.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
  return crs;
}

/// A projected system, compounded with that of a geoid where heights are above one. Of heights above
/// the ellipsoid GDAL 3.6 can write no system into a GeoTIFF, neither a third axis nor a compound.
OGRSpatialReference system_of(int epsg, HeightDatum heights) {
  OGRSpatialReference ground = known_system(epsg);
  if (height_epsg(heights) == 0) return ground;
  const OGRSpatialReference up = known_system(height_epsg(heights));
  const std::string name = std::string(ground.GetName()) + " + " + up.GetName();
  OGRSpatialReference both;
  if (both.SetCompoundCS(name.c_str(), &ground, &up) != OGRERR_NONE)
    throw Error("EPSG:" + std::to_string(epsg) + ": cannot be given heights (" + gdal_error() +
                "), expected a projected system");
  both.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
  return both;
}

GDALDataType gdal_type(CellType type) {
  if (type == CellType::uint8) return GDT_Byte;
  return type == CellType::uint16 ? GDT_UInt16 : GDT_Float32;
}

/// A value as it is stored: whole and clipped where the type is.
float stored(float v, CellType type, double nodata) {
  if (!std::isfinite(v)) return static_cast<float>(nodata);
  if (type == CellType::float32) return v;
  return std::round(std::clamp(v, 0.0F, type == CellType::uint8 ? 255.0F : 65535.0F));
}

/// What a raster is, besides its values.
/// C       its bands
/// throws  IoError; Error for a system GDAL does not know
void describe(const fs::path& path, GDALDataset& d, Index C, const GeoGrid& grid,
              const GeoTags& tags) {
  const auto check = [&](CPLErr result) {
    if (result != CE_None) refuse(path);
  };
  if (!(grid.step > 0))
    throw Error("write_geo_raster: cells of " + digits(grid.step) + " m, expected a positive size");
  if (!tags.band_names.empty() && static_cast<Index>(tags.band_names.size()) != C)
    throw Error("write_geo_raster: " + std::to_string(tags.band_names.size()) +
                " band names, expected " + std::to_string(C));
  if (grid.epsg != 0) {
    const OGRSpatialReference crs = system_of(grid.epsg, tags.heights);
    check(d.SetSpatialRef(&crs));
  }
  std::array<double, 6> transform{grid.x0, grid.step, 0, grid.y0, 0, -grid.step};
  check(d.SetGeoTransform(transform.data()));
  check(d.SetMetadataItem("AREA_OR_POINT", "Area"));
  if (!tags.description.empty())
    check(d.SetMetadataItem("TIFFTAG_IMAGEDESCRIPTION", tags.description.c_str()));
  if (!tags.software.empty()) check(d.SetMetadataItem("TIFFTAG_SOFTWARE", tags.software.c_str()));
  if (tags.heights != HeightDatum::none)
    check(d.SetMetadataItem("VERTICAL_DATUM", datum_text(tags.heights)));
  for (const auto& [key, value] : tags.metadata)
    check(d.SetMetadataItem(key.c_str(), value.c_str()));
  constexpr std::array kColours{GCI_RedBand, GCI_GreenBand, GCI_BlueBand};
  const bool picture = tags.type != CellType::float32 && C == 3;
  for (Index c = 0; c < C; ++c) {
    GDALRasterBand* band = d.GetRasterBand(static_cast<int>(c) + 1);
    check(band->SetNoDataValue(tags.nodata));
    if (!tags.unit.empty()) check(band->SetUnitType(tags.unit.c_str()));
    if (!tags.band_names.empty())
      band->SetDescription(tags.band_names[static_cast<std::size_t>(c)].c_str());
    if (picture) check(band->SetColorInterpretation(kColours[static_cast<std::size_t>(c)]));
  }
}

/// A band's values as they are stored, in floats still.
std::vector<float> stored_plane(const Tensor& values, Index plane, Index count,
                                const GeoTags& tags) {
  std::vector<float> out(static_cast<std::size_t>(count));
  const float* from = values.data() + plane * count;
  std::transform(from, from + count, out.begin(),
                 [&](float v) { return stored(v, tags.type, tags.nodata); });
  return out;
}

/// How a cloud-optimised GeoTIFF is made. The lowest level takes three quarters of the time of the usual
/// one, and 1 % more bytes.
std::vector<const char*> cog_options(bool means) {
  return {"COMPRESS=DEFLATE", "LEVEL=1", "PREDICTOR=YES", "BIGTIFF=IF_SAFER",
          means ? "OVERVIEW_RESAMPLING=AVERAGE" : "OVERVIEW_RESAMPLING=MODE"};
}

}  // namespace

const char* datum_text(HeightDatum datum) {
  switch (datum) {
    case HeightDatum::ellipsoid:
      return "WGS84 ellipsoid";
    case HeightDatum::egm96:
      return "EGM96 geoid";
    case HeightDatum::egm2008:
      return "EGM2008 geoid";
    case HeightDatum::none:
      break;
  }
  return "";
}

std::string crs_wkt(int epsg) {
  const GdalScope scope;
  return wkt_of(known_system(epsg), nullptr);
}

int height_epsg(HeightDatum datum) {
  if (datum == HeightDatum::egm96) return 5773;
  return datum == HeightDatum::egm2008 ? 3855 : 0;
}

GeoTags height_tags(const std::string& description, HeightDatum datum) {
  GeoTags tags;
  tags.unit = "m", tags.description = description, tags.heights = datum;
  return tags;
}

GeoTags ellipsoidal_height(const std::string& description) {
  return height_tags(description, HeightDatum::ellipsoid);
}

void write_geo_raster(const fs::path& path, const Tensor& values, const GeoGrid& grid,
                      const GeoTags& tags) {
  const auto [C, H, W] = extents_of("write_geo_raster", values, false);
  const GdalScope scope;
  MemoryRaster raster(path, "MEM", {static_cast<int>(W), static_cast<int>(H), static_cast<int>(C)},
                      gdal_type(tags.type));
  describe(path, *raster, C, grid, tags);
  const auto w = static_cast<int>(W), h = static_cast<int>(H);
  for (Index c = 0; c < C; ++c) {
    std::vector<float> plane = stored_plane(values, c, H * W, tags);
    raster.check(
        raster->GetRasterBand(static_cast<int>(c) + 1)
            ->RasterIO(GF_Write, 0, 0, w, h, plane.data(), w, h, GDT_Float32, 0, 0, nullptr));
  }
  raster.convert("COG", cog_options(tags.means));
  raster.save();
}

DatasetPtr bare_raster(const fs::path& path, const fs::path& file, Index bands, Index height,
                       Index width, GDALDataType type) {
  const Index cell = GDALGetDataTypeSizeBytes(type), row = width * cell, plane = height * row;
  std::unique_ptr<std::FILE, int (*)(std::FILE*)> made(std::fopen(file.c_str(), "wb"),
                                                       &std::fclose);
  const int error = made ? ::posix_fallocate(::fileno(made.get()), 0, bands * plane) : errno;
  if (error != 0) {
    std::error_code ignored;
    fs::remove(file, ignored);
    throw IoError(path.string() + ": " + std::to_string(bands * plane) +
                  " bytes for its values cannot be had (" + std::strerror(error) + ")");
  }
  DatasetPtr out(
      driver_of_name(path, "VRT")
          .Create("", static_cast<int>(width), static_cast<int>(height), 0, type, nullptr));
  if (!out) refuse(path);
  for (Index b = 0; b < bands; ++b) {
    CPLStringList how;
    how.SetNameValue("subclass", "VRTRawRasterBand");
    how.SetNameValue("SourceFilename", file.c_str());
    how.SetNameValue("relativeToVRT", "0");
    how.SetNameValue("ImageOffset", std::to_string(b * plane).c_str());
    how.SetNameValue("PixelOffset", std::to_string(cell).c_str());
    how.SetNameValue("LineOffset", std::to_string(row).c_str());
    how.SetNameValue("ByteOrder", CPL_IS_LSB ? "LSB" : "MSB");
    if (out->AddBand(type, how) != CE_None) refuse(path);
  }
  return out;
}

void write_cog(const fs::path& path, GDALDataset& from, bool means) {
  const TemporaryFile made(path.string() + ".part");
  CPLErrorReset();
  from.FlushCache();  // may be where a disk is found full
  if (CPLGetLastErrorType() >= CE_Failure) refuse(path);
  CPLStringList list;
  for (const char* option : cog_options(means)) list.AddString(option);
  DatasetPtr cog(driver_of_name(path, "COG")
                     .CreateCopy(made.path().c_str(), &from, FALSE, list, nullptr, nullptr));
  if (!cog) refuse(path);
  CPLErrorReset();
  cog.reset();
  if (CPLGetLastErrorType() >= CE_Failure) refuse(path);
  put_in_place(made.path(), path);
}

/// The rows so far, in a file beside the one to be made. They are written here, a band's at a time:
/// GDAL would write each row by itself.
struct GeoRasterRows::File {
  explicit File(fs::path path) : rows(std::move(path)) {}

  TemporaryFile rows;
  DatasetPtr dataset;
  std::unique_ptr<std::FILE, int (*)(std::FILE*)> values{nullptr, &std::fclose};
};

GeoRasterRows::GeoRasterRows(fs::path path, Index bands, Index height, Index width,
                             const GeoGrid& grid, GeoTags tags)
    : path_(std::move(path)),
      bands_(bands),
      height_(height),
      width_(width),
      tags_(std::move(tags)) {
  const GdalScope scope;
  file_ = std::make_unique<File>(path_.string() + ".rows");
  const fs::path& rows = file_->rows.path();
  file_->dataset = bare_raster(path_, rows, bands, height, width, gdal_type(tags_.type));
  file_->values.reset(std::fopen(rows.c_str(), "r+b"));
  if (!file_->values)
    throw IoError(rows.string() + ": cannot be opened (" + std::strerror(errno) + ")");
  std::setvbuf(file_->values.get(), nullptr, _IONBF, 0);  // an error shows where it happens
  describe(path_, *file_->dataset, bands, grid, tags_);
}

GeoRasterRows::~GeoRasterRows() = default;

void GeoRasterRows::append(const Tensor& values) {
  const auto [C, H, W] = extents_of("GeoRasterRows", values, false);
  if (C != bands_ || W != width_ || next_ + H > height_)
    throw ShapeError("GeoRasterRows: values " + values.shape().str() + " below row " +
                     std::to_string(next_) + ", expected " + std::to_string(bands_) +
                     " bands of rows of " + std::to_string(width_) + " cells, " +
                     std::to_string(height_) + " in all");
  const GDALDataType type = gdal_type(tags_.type);
  const Index cell = GDALGetDataTypeSizeBytes(type), count = H * W;
  std::vector<std::byte> bytes(static_cast<std::size_t>(count * cell));
  std::FILE* const file = file_->values.get();
  for (Index c = 0; c < C; ++c) {
    const std::vector<float> plane = stored_plane(values, c, count, tags_);
    GDALCopyWords64(plane.data(), GDT_Float32, sizeof(float), bytes.data(), type,
                    static_cast<int>(cell), count);
    const Index begin = (c * height_ + next_) * width_ * cell;
    if (std::fseek(file, begin, SEEK_SET) != 0 ||
        std::fwrite(bytes.data(), 1, bytes.size(), file) != bytes.size())
      throw IoError(path_.string() + ": its values cannot be written (" + std::strerror(errno) +
                    ")");
  }
  next_ += H;
}

void GeoRasterRows::finish() {
  if (next_ != height_)
    throw Error("GeoRasterRows: " + std::to_string(next_) + " rows of " + path_.string() +
                ", expected " + std::to_string(height_));
  const GdalScope scope;
  write_cog(path_, *file_->dataset, tags_.means);
  file_.reset();
}

void write_rpc_geotiff(const fs::path& path, const Tensor& pixels, PixelType type, const Rpc& rpc,
                       const std::map<std::string, std::string>& metadata) {
  const auto [C, H, W] = extents_of("write_rpc_geotiff", pixels, true);
  const GdalScope scope;
  const auto w = static_cast<int>(W), h = static_cast<int>(H), bands = static_cast<int>(C);
  const bool wide = type == PixelType::uint16;
  MemoryRaster tiff(path, "GTiff", {w, h, bands}, wide ? GDT_UInt16 : GDT_Byte,
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

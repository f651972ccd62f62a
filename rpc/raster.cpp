// SPDX-License-Identifier: Apache-2.0
#include "satsurf/rpc/raster.h"

#include "satsurf/core/atomic_file.h"
#include "satsurf/core/files.h"
#include "satsurf/rpc/camera_check.h"
#include "satsurf/rpc/gdal.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <sstream>
#include <vector>

#include <ogr_spatialref.h>

namespace satsurf::rpc {
namespace {

namespace fs = std::filesystem;

/// What a raster says of its heights.
HeightDatum heights_of(const OGRSpatialReference* crs,
                       const std::map<std::string, std::string>& metadata) {
  const char* code = crs && crs->IsCompound() ? crs->GetAuthorityCode("VERT_CS") : nullptr;
  const auto text = metadata.find("VERTICAL_DATUM");
  for (const HeightDatum datum : {HeightDatum::ellipsoid, HeightDatum::egm96, HeightDatum::egm2008})
    if ((code && std::atoi(code) == height_epsg(datum)) ||
        (!code && text != metadata.end() && text->second == datum_text(datum)))
      return datum;
  return HeightDatum::none;
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

/// throws  IoError for a grid that lies nowhere on the Earth, or whose cells are smaller than any sensor's
void check_place(const fs::path& path, double x, double y, double step) {
  constexpr double kFarthest = 1e8, kFinest = 1e-3;  // m; twice round the Earth
  // What is 0 or below is told by those who know how the file says it.
  if (std::abs(x) <= kFarthest && std::abs(y) <= kFarthest && !(step > kFarthest) &&
      !(step > 0 && step < kFinest))
    return;
  std::ostringstream text;
  text << path.string() << ": a grid at (" << x << ", " << y << ") of cells of " << step
       << " m, expected finite numbers of at most 1e8 m and cells of 0.001 m or more";
  throw IoError(text.str());
}

GeoGrid read_dfc_grid(const fs::path& path, const fs::path& text_path, Index width, Index height,
                      const std::optional<UtmZone>& zone) {
  if (!path_exists(text_path))
    throw IoError(path.string() + ": no georeference, expected one in the file or in " +
                  text_path.string());
  std::istringstream text(read_text_file(text_path, "a grid in four numbers"));
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
  check_place(text_path, numbers[0], numbers[1], step);
  if (!(step > 0) || cells != static_cast<double>(width) || cells != static_cast<double>(height)) {
    std::ostringstream message;
    message << text_path.string() << ": " << cells << " cells per side of " << step << " m, but "
            << path.string() << " has " << width << " x " << height;
    throw IoError(message.str());
  }
  return {zone ? zone->epsg() : 0, numbers[0], numbers[1] + cells * step, step};
}

}  // namespace

bool has_place(GDALDataset& d) {
  std::array<double, 6> t{};
  return d.GetGeoTransform(t.data()) == CE_None && t != std::array<double, 6>{0, 1, 0, 0, 0, 1};
}

GeoGrid grid_of(const fs::path& path, GDALDataset& d, const std::optional<UtmZone>& zone) {
  std::array<double, 6> t{};
  d.GetGeoTransform(t.data());
  if (!has_place(d))
    return read_dfc_grid(path, dfc_grid_path(path), d.GetRasterXSize(), d.GetRasterYSize(), zone);
  const double step = t[1];
  if (t[2] != 0 || t[4] != 0 || !(step > 0) || !(std::abs(t[5] + step) <= 1e-6 * step)) {
    std::ostringstream text;
    text << path.string() << ": cells of (" << t[1] << ", " << t[2] << "; " << t[4] << ", " << t[5]
         << "), expected square ones with north up; warp it first (gdalwarp)";
    throw IoError(text.str());
  }
  check_place(path, t[0], t[3], step);
  int epsg = zone ? zone->epsg() : 0;
  if (const OGRSpatialReference* crs = d.GetSpatialRef(); crs != nullptr && !crs->IsLocal()) {
    if (crs->IsGeographic())
      throw IoError(
          path.string() +
          ": coordinates in degrees, expected a projected system in metres; warp it first "
          "(gdalwarp)");
    epsg = epsg_of(*crs);
  }
  return {epsg, t[0], t[3], step};
}

GeoRaster read_geo_raster(const fs::path& path, const std::optional<UtmZone>& zone) {
  const GdalScope scope;
  const DatasetPtr d = open_raster(path);
  GeoRaster out;
  out.grid = grid_of(path, *d, zone);
  const int w = d->GetRasterXSize(), h = d->GetRasterYSize(), bands = d->GetRasterCount();
  const Index H = h, W = w, C = bands;
  constexpr double kMostValues = 4294967296;  // 16 GiB; surface models of whole scenes have 1e9
  const double count = static_cast<double>(C) * static_cast<double>(H) * static_cast<double>(W);
  if (count > kMostValues)
    throw IoError(path.string() + ": " + std::to_string(w) + " x " + std::to_string(h) +
                  " cells of " + std::to_string(bands) + (bands == 1 ? " band" : " bands") +
                  ", expected at most 4294967296 values; cut out a part (gdal_translate -projwin)");
  check_content(path, *d);
  check_memory(path, *d, 4 * count);
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
  if (const auto text = out.tags.metadata.extract("TIFFTAG_SOFTWARE"))
    out.tags.software = text.mapped();
  out.tags.heights = heights_of(d->GetSpatialRef(), out.tags.metadata);
  return out;
}

void require_same_grid(const fs::path& path, const GeoRaster& raster, const fs::path& other_path,
                       const GeoRaster& other) {
  const GeoGrid &a = raster.grid, &b = other.grid;
  const auto side = [](const GeoRaster& r, Index from_last) {
    return r.values.dim(r.values.rank() - from_last);
  };
  const double most = 0.6 * b.step,
               cells = static_cast<double>(std::max(side(other, 1), side(other, 2)));
  if (raster.values.shape() == other.values.shape() && std::abs(a.x0 - b.x0) < most &&
      std::abs(a.y0 - b.y0) < most && std::abs(a.step - b.step) * cells < most &&
      (a.epsg == 0 || b.epsg == 0 || a.epsg == b.epsg))
    return;
  const auto text_of = [&](const GeoRaster& r) {
    const Index bands = r.values.rank() == 3 ? r.values.dim(0) : 1;
    std::ostringstream text;
    text.precision(10);
    text << side(r, 1) << " x " << side(r, 2) << " cells of " << r.grid.step << " m from "
         << r.grid.x0 << ", " << r.grid.y0;
    if (r.grid.epsg != 0) text << " in EPSG:" << r.grid.epsg;
    if (bands > 1) text << ", " << bands << " bands";
    return text.str();
  };
  throw IoError(path.string() + ": " + text_of(raster) + ", expected the grid of " +
                other_path.string() + ", " + text_of(other));
}

void require_heights(const fs::path& path, const Tensor& values) {
  const Index W = values.dim(values.rank() - 1), H = values.dim(values.rank() - 2);
  for (Index i = 0; i < values.count(); ++i) {
    const auto h = static_cast<double>(values[i]);
    if (std::isnan(h) || on_earth({h, h})) continue;
    std::ostringstream text;
    text << path.string() << ": a height of " << h << " m in column " << i % W << ", row "
         << i / W % H
         << ", expected at most 1000 km either way; nodata that the file does not declare?";
    throw IoError(text.str());
  }
}

GeoRaster read_reduced_raster(const fs::path& path, Index factor) {
  constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
  if (factor < 1)
    throw Error("read_reduced_raster: blocks of " + std::to_string(factor) +
                " cells, expected 1 or more");
  const GdalScope scope;
  const DatasetPtr d = open_raster(path);
  GeoRaster out;
  out.grid = grid_of(path, *d, {});
  out.grid.step *= static_cast<double>(factor);
  const Index H = d->GetRasterYSize(), W = d->GetRasterXSize(), C = d->GetRasterCount();
  const Index h = (H + factor - 1) / factor, w = (W + factor - 1) / factor;
  check_content(path, *d);
  check_memory(path, *d,
               4 * (static_cast<double>(C * h * w) + static_cast<double>(W * (factor + 4))));
  out.values = Tensor(C == 1 ? Shape{h, w} : Shape{C, h, w}, kNan);
  std::vector<float> rows(static_cast<std::size_t>(W * factor));
  std::vector<double> sum(static_cast<std::size_t>(w)), count(static_cast<std::size_t>(w));
  for (Index c = 0; c < C; ++c) {
    GDALRasterBand* band = d->GetRasterBand(static_cast<int>(c) + 1);
    int has_nodata = 0;
    const auto nodata = static_cast<float>(band->GetNoDataValue(&has_nodata));
    for (Index y = 0; y < h; ++y) {
      const Index n = std::min(factor, H - y * factor);
      if (band->RasterIO(GF_Read, 0, static_cast<int>(y * factor), static_cast<int>(W),
                         static_cast<int>(n), rows.data(), static_cast<int>(W), static_cast<int>(n),
                         GDT_Float32, 0, 0, nullptr) != CE_None)
        throw IoError(path.string() + ": the values cannot be read, expected a whole file; " +
                      gdal_error());
      std::fill(sum.begin(), sum.end(), 0.0);
      std::fill(count.begin(), count.end(), 0.0);
      for (Index i = 0; i < n * W; ++i) {
        const float v = rows[static_cast<std::size_t>(i)];
        if ((has_nodata && v == nodata) || !std::isfinite(v)) continue;
        const auto at = static_cast<std::size_t>(i % W / factor);
        sum[at] += static_cast<double>(v), count[at] += 1;
      }
      for (Index x = 0; x < w; ++x)
        if (const auto at = static_cast<std::size_t>(x); count[at] > 0)
          out.values[(c * h + y) * w + x] = static_cast<float>(sum[at] / count[at]);
    }
  }
  out.tags.heights = heights_of(d->GetSpatialRef(), metadata_of(*d, ""));
  return out;
}

void write_dfc_grid(const fs::path& path, const GeoGrid& grid, Index size) {
  char text[200];
  std::snprintf(text, sizeof text, "%.6f\n%.6f\n%.6f\n%.6f\n", grid.x0,
                grid.y0 - static_cast<double>(size) * grid.step, static_cast<double>(size),
                grid.step);
  atomic_write(path, text);
}

}  // namespace satsurf::rpc

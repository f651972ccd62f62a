// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/tensor.h"
#include "satsurf/rpc/frame.h"

#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

namespace satsurf::rpc {

/// A north-up grid of square cells; row 0 is north.
struct GeoGrid {
  int epsg = 0;           ///< of the projected system, UtmZone::epsg() as a rule; 0 if unknown
  double x0 = 0, y0 = 0;  ///< easting and northing of the upper-left corner, m
  double step = 1;        ///< side of a cell, m
  friend bool operator==(const GeoGrid&, const GeoGrid&) = default;
};

/// What else a GeoTIFF says about its values.
struct GeoTags {
  std::string unit = "m";               ///< of every band; empty for none
  std::string description;              ///< of the file (TIFF ImageDescription)
  std::vector<std::string> band_names;  ///< empty or one per band
  /// Free key = value pairs. The vertical datum of heights belongs here, see ellipsoidal_height().
  std::map<std::string, std::string> metadata;
};

/// Tags of a height raster: unit m, VERTICAL_DATUM = WGS84 ellipsoid.
/// description  of the file
GeoTags ellipsoidal_height(const std::string& description);

constexpr float kNodata = -9999;  ///< written for NaN, and declared

/// A Float32 GeoTIFF, tiled, DEFLATE with predictor 3; pixels are areas and NaN becomes kNodata.
/// The same values give the same bytes; the file appears whole, under its name, or not at all.
/// values  [H W] or [C H W]
/// grid    of the values
/// tags    what else the file says
/// throws  IoError; ShapeError; Error for a system GDAL does not know
void write_geo_raster(const std::filesystem::path& path, const Tensor& values, const GeoGrid& grid,
                      const GeoTags& tags = {});

/// A raster on the ground.
struct GeoRaster {
  Tensor values;  ///< [H W], or [C H W] where there are more bands than one; NaN where nodata
  GeoGrid grid;
  GeoTags tags;
};

/// Any north-up raster of square cells that GDAL opens. DFC2019's `NAME_DSM.tif` (and
/// `NAME_CLS.tif`) have no georeference; their grid is taken from `NAME_DSM.txt` beside them
/// (easting and northing of the lower-left corner, cells per side, metres per cell).
/// zone    system of a raster that names none
/// throws  IoError for no georeference, a rotated grid, cells that are not square, a damaged file
GeoRaster read_geo_raster(const std::filesystem::path& path,
                          const std::optional<UtmZone>& zone = {});

/// Writes the grid of a raster without a georeference the way DFC2019 does.
/// size    cells per side
/// throws  IoError
void write_dfc_grid(const std::filesystem::path& path, const GeoGrid& grid, Index size);

/// How an image is stored.
enum class PixelType { uint8, uint16 };

/// A satellite image as a tiled DEFLATE GeoTIFF with its camera in the RPC tag. Values are rounded
/// and clipped to the pixel type. The same values give the same bytes.
/// pixels    [C H W]
/// type      of the stored pixels
/// rpc       camera of the image
/// metadata  key = value pairs, read back as RasterInfo says (SUN_ELEVATION, SUN_AZIMUTH in
///           degrees, ACQUISITION_DATE)
/// throws    IoError, ShapeError
void write_rpc_geotiff(const std::filesystem::path& path, const Tensor& pixels, PixelType type,
                       const Rpc& rpc, const std::map<std::string, std::string>& metadata = {});

}  // namespace satsurf::rpc

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/tensor.h"
#include "satsurf/rpc/frame.h"

#include <filesystem>
#include <map>
#include <memory>
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

/// What heights are above; none for values that are no heights.
enum class HeightDatum { none, ellipsoid, egm96, egm2008 };
/// In words: "WGS84 ellipsoid", "EGM96 geoid", "EGM2008 geoid"; empty for none.
const char* datum_text(HeightDatum datum);
/// EPSG code of the vertical system of a geoid; 0 for the others, which need none.
int height_epsg(HeightDatum datum);

/// How cells are stored.
enum class CellType { float32, uint8, uint16 };

constexpr float kNodata = -9999;  ///< written for NaN in Float32, and declared

/// What else a GeoTIFF says about its values.
struct GeoTags {
  std::string unit = "m";                 ///< of every band; empty for none
  std::string description{};              ///< of the file (TIFF ImageDescription)
  std::vector<std::string> band_names{};  ///< empty or one per band
  /// Free key = value pairs.
  std::map<std::string, std::string> metadata{};
  std::string software{};  ///< that made the values (TIFF Software)
  /// Becomes the metadata VERTICAL_DATUM; a geoid also a part of the reference system, which then
  /// is a compound one.
  HeightDatum heights = HeightDatum::none;
  CellType type = CellType::float32;  ///< to whole numbers values are rounded and clipped
  double nodata = kNodata;            ///< written for NaN, and declared
  bool means = true;                  ///< whether a mean of cells means something: overviews
};

/// Tags of a height raster in m.
/// description  of the file
/// datum        of the heights
GeoTags height_tags(const std::string& description, HeightDatum datum);
/// The same above the WGS84 ellipsoid.
GeoTags ellipsoidal_height(const std::string& description);

/// A cloud-optimised GeoTIFF: tiled, with overviews, DEFLATE with a predictor; pixels are areas and
/// NaN becomes the nodata value. Three bands of whole numbers are red, green and blue.
/// The same values give the same bytes; the file appears whole, under its name, or not at all.
/// values  [H W] or [C H W]
/// grid    of the values
/// tags    what else the file says
/// throws  IoError; ShapeError; Error for a system GDAL does not know
void write_geo_raster(const std::filesystem::path& path, const Tensor& values, const GeoGrid& grid,
                      const GeoTags& tags = {});

/// A raster too large for the memory, written from its first row to its last: the same file as of
/// `write_geo_raster`. The rows so far lie in a file beside it, which goes with this object.
class GeoRasterRows {
 public:
  /// height, width  cells of the whole raster
  /// throws         IoError; Error for a system GDAL does not know
  GeoRasterRows(std::filesystem::path path, Index bands, Index height, Index width,
                const GeoGrid& grid, GeoTags tags);
  ~GeoRasterRows();
  GeoRasterRows(const GeoRasterRows&) = delete;
  GeoRasterRows& operator=(const GeoRasterRows&) = delete;

  /// Writes the next rows, NaN where nothing is known.
  /// values  [h W] or [C h W]
  /// throws  IoError, ShapeError
  void append(const Tensor& values);
  /// Makes the raster of its rows, with overviews.
  /// throws  IoError; Error where rows are missing
  void finish();

 private:
  struct File;
  std::filesystem::path path_;
  Index bands_, height_, width_, next_ = 0;
  GeoTags tags_;
  std::unique_ptr<File> file_;
};

/// A raster on the ground.
struct GeoRaster {
  Tensor values;  ///< [H W], or [C H W] where there are more bands than one; NaN where nodata
  GeoGrid grid;
  GeoTags tags;  ///< without `type` and `nodata`
};

/// A north-up raster of square cells, of the formats that `read_info` takes. DFC2019's `NAME_DSM.tif` (and
/// `NAME_CLS.tif`) have no georeference; their grid is taken from `NAME_DSM.txt` beside them
/// (easting and northing of the lower-left corner, cells per side, metres per cell).
/// zone    system of a raster that names none on the Earth
/// throws  IoError for no georeference, a rotated grid, cells that are not square, a damaged file;
///         for more than 2^32 values, or more than its file or the memory can hold
GeoRaster read_geo_raster(const std::filesystem::path& path,
                          const std::optional<UtmZone>& zone = {});

/// As `read_geo_raster`, with the means of square blocks of cells for cells, read a row of blocks at a
/// time: of the blocks at the eastern and southern end what there is. Unknown cells do not count.
/// factor  side of a block, cells
/// throws  as `read_geo_raster`; Error for a factor below 1
GeoRaster read_reduced_raster(const std::filesystem::path& path, Index factor);

/// Refuses a raster whose cells are not those of another: more or fewer, in another system where both
/// name one, or more than half a cell away, by which files differ that count from corners of cells and
/// from their middles.
/// path, raster       what is checked, and the file that it comes from
/// other_path, other  likewise, of the cells it should have
/// throws             IoError naming both
void require_same_grid(const std::filesystem::path& path, const GeoRaster& raster,
                       const std::filesystem::path& other_path, const GeoRaster& other);

/// Refuses what is no height on the Earth: more than 1000 km above the ellipsoid or below it. NaN is none
/// at all, and may be there.
/// path    of the file they come from
/// throws  IoError naming the first such cell
void require_heights(const std::filesystem::path& path, const Tensor& values);

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

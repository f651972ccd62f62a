// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/tensor.h"
#include "satsurf/rpc/fit.h"
#include "satsurf/rpc/model.h"

#include <array>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

namespace satsurf::rpc {

/// What a file says about an image, without its pixels.
struct RasterInfo {
  std::filesystem::path path;
  /// All that was read: the file itself, what belongs to it, and where the camera came from.
  std::vector<std::filesystem::path> files;
  Index width = 0, height = 0, bands = 0;
  std::string dtype;  ///< uint8, uint16, int16, float32 or another of GDAL's, in these words
  std::optional<Rpc> rpc;
  /// Where the camera came from: "TIFF tag", "RPB", "_RPC.TXT", "Maxar XML", "DIMAP", ".rpc file", ".aux.xml",
  /// "NITF" or "Sat-NeRF JSON"; another driver's name for other formats. Empty without a camera.
  std::string rpc_source;
  std::vector<std::string> tried;  ///< the places looked in for a camera, best first
  std::optional<double> sun_elevation_deg, sun_azimuth_deg;
  std::optional<std::string> acquisition_date;  ///< as the file writes it
  std::optional<HeightRange> height_range;      ///< of the ground, m above the ellipsoid
  std::optional<double> nodata;
  /// Which channels are red, green and blue: by the bands' own colours; B G R N and C B G Y R RE N
  /// N2 of 4- and 8-band Maxar products that come with their metadata; else the first three.
  std::array<Index, 3> rgb_channels{0, 1, 2};
  std::string crs;        ///< "EPSG:32617", WKT where no code is known, empty without one
  std::string local_crs;  ///< name of a system that is tied to no place on the Earth, then instead
  std::optional<std::array<double, 6>> geotransform;  ///< GDAL's order, corner of the first pixel
};

/// An image, whole or a window of it.
struct Image {
  Tensor pixels;    ///< [C H W] values as stored
  Tensor valid;     ///< [H W] 1 or 0: nodata, NaN, a mask band or a transparent alpha
  RasterInfo info;  ///< of the part read: size and camera are the window's
};

/// Whole pixels of an image, columns x0.. and rows y0..
struct PixelWindow {
  Index x0 = 0, y0 = 0, width = 0, height = 0;
};

/// An image in a regular file: GeoTIFF, NITF, JPEG 2000, DIMAP, PNG, JPEG, BMP, ENVI, EHdr,
/// PCIDSK, AAIGrid, what `trust_drivers` names (rpc/drivers.h), or a VRT of such files. Nothing is
/// read over a network. The camera may sit in the file (TIFF tag, NITF RPC00B) or beside it
/// (NAME.RPB, NAME.XML, NAME_RPC.TXT, NAME.rpc, NAME.tif.aux.xml; RPC_NAME.XML beside IMG_NAME).
/// throws  IoError
RasterInfo read_info(const std::filesystem::path& path);

/// Reads the pixels and forgets them: of up to 100 million all, of more the last row, which a file that
/// was cut off lacks.
/// path    of a raster
/// throws  IoError naming what cannot be read
void check_pixels(const std::filesystem::path& path);

/// Pixels of type uint8, uint16, int16 or float32 (others are converted by GDAL). An alpha band is
/// taken into `valid` and is not among the channels.
/// path    of the raster
/// window  the part to read; all of it if left out
/// throws  IoError for a file that is missing, no raster, damaged or without one valid pixel; for a
///         window that leaves the image
Image read_image(const std::filesystem::path& path, const std::optional<PixelWindow>& window = {});

/// What of an image's values become colours.
struct RgbChoice {
  std::array<Index, 3> channels{0, 0, 0};  ///< red, green and blue, counted from 0
  float low = 0, high = 255;               ///< values that become 0 and 1
};
/// The choice of `to_rgb`.
/// throws  ShapeError
RgbChoice rgb_choice(const Image& image);

/// Colours for the network, by a choice made once for all parts of an image.
/// throws  ShapeError
Tensor to_rgb(const Image& image, const RgbChoice& choice);
/// Colours for the network.
///   channels  one or two: the first, three times; three or more: `info.rgb_channels` (Pleiades and
///             SPOT deliver R G B N)
///   values    uint8: / 255; others: the 1st to the 99th percentile of the valid pixels of these
///             channels together are stretched to [0, 1] and clipped, so that hue is kept
/// returns  [3 H W] in [0, 1]; invalid pixels are 0
/// throws   ShapeError
Tensor to_rgb(const Image& image);

/// The camera in a GDAL metadata domain "RPC".
/// items   keys LINE_OFF ... SAMP_DEN_COEFF
/// where   begins the error texts
/// throws  IoError naming the key that is missing or no number
Rpc rpc_from_gdal_metadata(const std::map<std::string, std::string>& items,
                           const std::string& where);

/// A camera file without its image, the dialect told by its content: `_RPC.TXT` ("KEY: value unit";
/// IKONOS, GeoEye, Planet, SkySat), `.RPB`, Maxar XML, DIMAP XML (its pixels count from 1; ours
/// from 0), GDAL .aux.xml, the 170 lines of WHU-TLC (whose inverse half is not used), Sat-NeRF JSON.
/// throws  IoError
Rpc read_rpc_file(const std::filesystem::path& path);

/// The JSON file of one view that Sat-NeRF, EO-NeRF and EOGS read.
struct SatNerfJson {
  std::string image;  ///< file name
  Index width = 0, height = 0;
  Rpc rpc;
  double min_alt = 0, max_alt = 0;  ///< m above the ellipsoid
  std::optional<double> sun_elevation_deg, sun_azimuth_deg;
  std::optional<std::string> acquisition_date;
};

/// Reads one; numbers may be strings ("+42.2").
/// throws  IoError naming the file and the key
SatNerfJson read_satnerf_json(const std::filesystem::path& path);

/// Whether a file's name says that it is such a JSON; its content may be anything.
bool names_json(const std::filesystem::path& path);

/// An image with its camera, found but not opened: a raster, or a Sat-NeRF JSON whose camera then
/// replaces that of the raster it names.
struct ViewSource {
  std::filesystem::path file;       ///< what was asked for: the raster or the JSON
  std::filesystem::path raster;     ///< where the pixels are
  std::optional<SatNerfJson> json;  ///< what the JSON says, if there is one
};
/// A JSON names images in its own folder and in those given, and in folders inside them, but nothing
/// else on the machine: it may come from a stranger. Links are followed.
/// path        of the raster or the JSON, which is read
/// image_dirs  folders to look in for the JSON's image, after the JSON's own
/// throws      IoError naming the places looked in for the image, and for one that lies elsewhere
ViewSource find_view(const std::filesystem::path& path,
                     const std::vector<std::filesystem::path>& image_dirs = {});

/// The pixels and the camera. The raster is opened once, and its camera is asked for before its
/// pixels.
/// throws  IoError without a camera, naming the file and where one was looked for; for a camera that sees no
///         ground from its image
Image open_view(const ViewSource& source);
/// As `open_view(find_view(path, image_dirs))`.
Image open_view(const std::filesystem::path& path,
                const std::vector<std::filesystem::path>& image_dirs = {});
/// A window of an image too large to be read whole; none of its pixels need be valid.
/// throws  IoError as `open_view`, and for a window that leaves the image
Image open_window(const ViewSource& source, const PixelWindow& window);
/// Every `factor`-th column and row of an image, from the middle of the first `factor` on; what is
/// left at the right and lower rim is cut off. The values are those of the image, whatever overviews it
/// has, so that a border keeps its one value, and the camera is the reduced image's.
/// Of JPEG 2000 the values are those of the nearest of its own resolutions: to decode a large image
/// whole takes minutes, ten times as long and more. They are smooth means, so that a border keeps its
/// value but beside what it surrounds.
/// throws  IoError as `open_view`; for an image that has fewer columns or rows than `factor`
Image open_reduced(const ViewSource& source, Index factor);
/// What `open_view(path, image_dirs)` says of an image, without its pixels.
/// throws  IoError as `open_view`
RasterInfo view_info(const std::filesystem::path& path,
                     const std::vector<std::filesystem::path>& image_dirs = {});
/// Bounds what the readers keep of blocks they have read, for the whole program; unless the user
/// has (GDAL_CACHEMAX in the environment). GDAL takes a twentieth of the memory.
void limit_block_cache(std::size_t bytes);

}  // namespace satsurf::rpc

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/rpc/read.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/files.h"
#include "satsurf/core/parallel.h"
#include "satsurf/rpc/fit.h"
#include "satsurf/rpc/frame.h"
#include "satsurf/rpc/gdal.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <sstream>

namespace satsurf::rpc {
namespace {

namespace fs = std::filesystem;

/// What is read of a file: a window, of which every `factor`-th column and row is kept.
struct Part {
  PixelWindow window;
  Index factor = 1;
  bool may_be_empty = false;  ///< without one valid pixel
  bool overviews = false;     ///< what is kept may be taken from smaller resolutions
  Index columns = 1;          ///< of those that are kept, how many are read at a time

  Index width() const { return window.width / factor; }
  Index height() const { return window.height / factor; }
  /// Whether rows are read whole and thinned out.
  bool by_rows() const { return factor > 1 && !overviews; }
};

/// Whether a file's smaller resolutions are worth their values: of a JPEG 2000, which a file in
/// pieces may consist of.
bool decodes_smaller(GDALDataset& d, const RasterInfo& info) {
  const char* packed = d.GetMetadataItem("NITF_IC");
  return (packed != nullptr && (EQUAL(packed, "C8") || EQUAL(packed, "M8"))) ||
         std::ranges::any_of(info.files, [](const fs::path& f) { return is_jpeg2000(f.string()); });
}

/// How many of the columns that are kept are read at a time: rows across more blocks than GDAL keeps
/// would have each of them decoded again and again.
Index columns_together(GDALDataset& d, Index factor) {
  constexpr double kMost = 32e6;  // bytes of a row of blocks
  int width = 0, height = 0;
  d.GetRasterBand(1)->GetBlockSize(&width, &height);
  double pixel = 0;
  for (int b = 1; b <= d.GetRasterCount(); ++b)
    pixel += GDALGetDataTypeSizeBytes(d.GetRasterBand(b)->GetRasterDataType());
  const double most = std::max<double>(width, kMost / (pixel * height));
  return std::max<Index>(1, static_cast<Index>(most) / factor);
}

/// Reads some bands of a part. GDAL takes overviews by itself where fewer values are wanted than there
/// are, and those of its pieces for a mosaic, so that rows are read whole and thinned out here.
/// to    [bands, height, width] of the part
/// read  RasterIO of a window into so many columns and rows of values
template <class T, class F>
CPLErr read_part(const Part& part, Index bands, T* to, const F& read) {
  const Index W = part.width(), H = part.height(), f = part.factor;
  const PixelWindow& w = part.window;
  if (!part.by_rows()) return read(PixelWindow{w.x0, w.y0, W * f, H * f}, to, W, H);
  std::vector<T> row(static_cast<std::size_t>(bands * std::min(part.columns, W) * f));
  for (Index u = 0; u < W; u += part.columns) {
    const Index n = std::min(part.columns, W - u);
    for (Index v = 0; v < H; ++v) {
      const PixelWindow from{w.x0 + u * f, w.y0 + v * f + f / 2, n * f, 1};
      if (const CPLErr error = read(from, row.data(), n * f, Index{1}); error != CE_None)
        return error;
      for (Index c = 0; c < bands; ++c)
        for (Index i = 0; i < n; ++i)
          to[(c * H + v) * W + u + i] = row[static_cast<std::size_t>((c * n + i) * f + f / 2)];
    }
  }
  return CE_None;
}

/// 1 where the file itself calls a pixel valid.
std::vector<std::uint8_t> file_mask(const fs::path& path, GDALDataset& d,
                                    const std::vector<int>& bands, const Part& part) {
  const auto N = static_cast<std::size_t>(part.width() * part.height());
  std::vector<std::uint8_t> valid(N, 1);
  const int flags = d.GetRasterBand(bands[0])->GetMaskFlags();
  if (flags & GMF_ALL_VALID) return valid;
  // One mask of the data set is enough; of masks by nodata value, a pixel is lost only where every
  // channel is: a dark blue roof with 0 in one channel is a roof.
  const std::size_t masks = flags & GMF_PER_DATASET ? 1 : bands.size();
  std::vector<std::uint8_t> band(N);
  std::fill(valid.begin(), valid.end(), std::uint8_t{0});
  for (std::size_t b = 0; b < masks; ++b) {
    GDALRasterBand* mask = d.GetRasterBand(bands[b])->GetMaskBand();
    const auto read = [&](const PixelWindow& w, std::uint8_t* to, Index width, Index height) {
      return mask->RasterIO(GF_Read, static_cast<int>(w.x0), static_cast<int>(w.y0),
                            static_cast<int>(w.width), static_cast<int>(w.height), to,
                            static_cast<int>(width), static_cast<int>(height), GDT_Byte, 0, 0,
                            nullptr);
    };
    if (read_part(part, 1, band.data(), read) != CE_None)
      throw IoError(path.string() + ": the mask cannot be read, expected a whole file; " +
                    gdal_error());
    for (std::size_t i = 0; i < N; ++i) valid[i] = valid[i] || band[i] != 0;
  }
  return valid;
}

/// Lowest values and highest of the middle 98 percent of the valid pixels of three channels
/// together.
std::pair<float, float> stretch_of(const Image& image, const std::array<Index, 3>& channels) {
  // values looked at: enough for a percentile, little for the memory
  constexpr Index kSample = 1 << 22;
  const Index N = image.valid.count(), distinct = channels[0] == channels[2] ? 1 : 3;
  const Index stride = std::max<Index>(1, N * distinct / kSample);
  std::vector<float> values;
  for (Index c = 0; c < distinct; ++c)
    for (Index i = 0; i < N; i += stride)
      if (image.valid[i] != 0)
        values.push_back(image.pixels[channels[static_cast<std::size_t>(c)] * N + i]);
  if (values.empty()) return {0, 1};
  const auto at = [&](double part) {
    const auto k =
        static_cast<std::ptrdiff_t>(std::llround(part * static_cast<double>(values.size() - 1)));
    std::nth_element(values.begin(), values.begin() + k, values.end());
    return values[static_cast<std::size_t>(k)];
  };
  const float low = at(0.01), high = at(0.99);
  return {low, high};
}

/// Refuses a camera that sees no ground from its own image, among several that would only be known by
/// the camera's complaint.
/// path    of the view
/// throws  IoError
void check_sight(const fs::path& path, const RasterInfo& info) {
  const auto right = static_cast<double>(info.width) - 0.5,
             below = static_cast<double>(info.height) - 0.5;
  const Pixel middle{(right - 0.5) / 2, (below - 0.5) / 2};
  const Rpc& rpc = *info.rpc;
  try {
    const Geodetic at = rpc.localize(middle, rpc.height_off);
    const LocalFrame frame{utm_zone_of(at.lon, at.lat)};
    view_geometry(pixel_jacobian(rpc, frame, frame.local_from_geodetic(at)));
    for (const Pixel& corner :
         {Pixel{-0.5, -0.5}, Pixel{right, -0.5}, Pixel{right, below}, Pixel{-0.5, below}})
      rpc.localize(corner, rpc.height_off);
  } catch (const Error& e) {
    throw IoError(path.string() + ": its camera sees no ground; " + e.what());
  }
}

/// Puts in what the JSON knows better, checks that it belongs to the image, and that there is a
/// camera.
void complete(RasterInfo& info, const ViewSource& source) {
  const fs::path& path = source.file;
  if (source.json) {
    const SatNerfJson& j = *source.json;
    if (j.width != info.width || j.height != info.height) {
      std::ostringstream text;
      text << path.string() << ": says " << j.width << " x " << j.height << " px, but "
           << source.raster.string() << " has " << info.width << " x " << info.height;
      throw IoError(text.str());
    }
    info.rpc = j.rpc;
    info.rpc_source = "Sat-NeRF JSON";
    info.files.insert(info.files.begin(), path);
    info.tried.insert(info.tried.begin(), path.filename().string());
    info.height_range = HeightRange{j.min_alt, j.max_alt};
    if (j.sun_elevation_deg) info.sun_elevation_deg = j.sun_elevation_deg;
    if (j.sun_azimuth_deg) info.sun_azimuth_deg = j.sun_azimuth_deg;
    if (j.acquisition_date) info.acquisition_date = j.acquisition_date;
  }
  if (info.rpc) return check_sight(path, info);
  std::string tried;
  for (const std::string& name : info.tried) tried += (tried.empty() ? "" : ", ") + name;
  throw IoError(path.string() + ": no camera (RPC), looked for " + tried);
}

/// All of a file, or the window that is named.
Part part_of(const RasterInfo& info, const std::optional<PixelWindow>& window = {}) {
  return {window.value_or(PixelWindow{0, 0, info.width, info.height})};
}

/// The pixels of an open file, and which of them are valid.
/// info    of the whole file
/// part    the part to read
/// throws  IoError
Image read_pixels(const fs::path& path, GDALDataset& d, RasterInfo info, const Part& part) {
  Image image;
  const PixelWindow& w = part.window;
  if (w.x0 < 0 || w.y0 < 0 || w.width < 1 || w.height < 1 || w.x0 + w.width > info.width ||
      w.y0 + w.height > info.height) {
    std::ostringstream text;
    text << path.string() << ": window of " << w.width << " x " << w.height << " px at (" << w.x0
         << ", " << w.y0 << "), expected one inside " << info.width << " x " << info.height;
    throw IoError(text.str());
  }

  std::vector<int> bands = colour_bands(d);
  const Index C = info.bands, H = part.height(), W = part.width(), N = H * W;
  check_content(path, d);
  // pixels and validity as floats, two masks of a byte
  const Index row = part.by_rows() ? C * std::min(part.columns, W) * part.factor : 0;
  check_memory(
      path, d,
      static_cast<double>(N) * (4 * static_cast<double>(C + 1) + 2) + 4 * static_cast<double>(row));
  image.pixels = Tensor::uninitialised({C, H, W});
  const auto read = [&](const PixelWindow& from, float* to, Index width, Index height) {
    return d.RasterIO(GF_Read, static_cast<int>(from.x0), static_cast<int>(from.y0),
                      static_cast<int>(from.width), static_cast<int>(from.height), to,
                      static_cast<int>(width), static_cast<int>(height), GDT_Float32,
                      static_cast<int>(C), bands.data(), 0, 0, 0, nullptr);
  };
  CPLErrorReset();
  if (read_part(part, C, image.pixels.data(), read) != CE_None)
    throw IoError(path.string() + ": the pixels cannot be read, expected a whole file; " +
                  gdal_error());

  const auto mask = file_mask(path, d, bands, part);
  check_refused(path);
  image.valid = Tensor::uninitialised({H, W});
  const Index count = ordered_reduce<Index>(N, Index{1} << 16, 0, [&](Index begin, Index end) {
    Index valid = 0;
    for (Index i = begin; i < end; ++i) {
      bool ok = mask[static_cast<std::size_t>(i)] != 0;
      for (Index c = 0; c < C; ++c) ok = ok && std::isfinite(image.pixels[c * N + i]);
      image.valid[i] = ok ? 1.0F : 0.0F;
      valid += ok;
    }
    return valid;
  });
  if (count == 0 && !part.may_be_empty)
    throw IoError(path.string() +
                  ": no valid pixel (all nodata, masked or NaN), expected an image");

  // Of `factor` pixels the one in the middle is kept, which of an even number is half a pixel beyond.
  const auto f = static_cast<double>(part.factor), off = part.factor % 2 == 0 ? 0.5 : 0.0;
  const double x = static_cast<double>(w.x0) + off, y = static_cast<double>(w.y0) + off;
  if (info.rpc) info.rpc = info.rpc->cropped(x, y);
  if (info.rpc && part.factor > 1) info.rpc = info.rpc->resized(1 / f);
  if (auto& t = info.geotransform) {
    (*t)[0] += (*t)[1] * x + (*t)[2] * y;
    (*t)[3] += (*t)[4] * x + (*t)[5] * y;
    for (const std::size_t k : {1, 2, 4, 5}) (*t)[k] *= f;
  }
  info.width = W;
  info.height = H;
  image.info = std::move(info);
  return image;
}

/// A part of a view.
/// choose  which, by what the file says of itself
template <class F>
Image open_part(const ViewSource& source, const F& choose) {
  const GdalScope scope;
  const DatasetPtr d = open_raster(source.raster);
  RasterInfo info = info_of(source.raster, *d);
  complete(info, source);
  Part part = choose(info);
  if (part.factor > 1) {
    part.overviews = decodes_smaller(*d, info);
    part.columns = columns_together(*d, part.factor);
  }
  return read_pixels(source.raster, *d, std::move(info), part);
}

/// Whether a path ends in a folder, whatever `..` it takes.
bool leads_into(const fs::path& folder, const fs::path& path) {
  std::error_code unknown;  // without a working folder nothing is found anyhow
  const auto whole = [&](const fs::path& p) {
    return fs::absolute(p.empty() ? "." : p, unknown).lexically_normal();
  };
  const fs::path inside = whole(path).lexically_relative(whole(folder));
  return !inside.empty() && *inside.begin() != "..";
}

}  // namespace

Image read_image(const fs::path& path, const std::optional<PixelWindow>& window) {
  const GdalScope scope;
  const DatasetPtr d = open_raster(path);
  RasterInfo info = info_of(path, *d);
  const Part part = part_of(info, window);
  return read_pixels(path, *d, std::move(info), part);
}

bool names_json(const fs::path& path) {
  return path.extension() == ".json" || path.extension() == ".JSON";
}

ViewSource find_view(const fs::path& path, const std::vector<fs::path>& image_dirs) {
  if (!names_json(path)) return {path, path, {}};
  SatNerfJson json = read_satnerf_json(path);
  std::vector<fs::path> folders{path.parent_path()};
  folders.insert(folders.end(), image_dirs.begin(), image_dirs.end());
  std::string tried;
  for (const fs::path& folder : folders) {
    const fs::path raster = folder / json.image;
    if (std::ranges::none_of(folders, [&](const fs::path& f) { return leads_into(f, raster); }))
      continue;
    if (path_exists(raster)) return {path, raster, std::move(json)};
    tried += (tried.empty() ? "" : ", ") + raster.string();
  }
  if (tried.empty())
    throw IoError(path.string() + ": its image \"" + json.image +
                  "\" lies elsewhere, expected it in the folder of the file; name its folder");
  throw IoError(path.string() + ": its image \"" + json.image + "\" was not found, looked for " +
                tried + "; name its folder");
}

Image open_view(const ViewSource& source) {
  return open_part(source, [](const RasterInfo& info) { return part_of(info); });
}

Image open_window(const ViewSource& source, const PixelWindow& window) {
  return open_part(source, [&](const RasterInfo&) { return Part{window, 1, true}; });
}

Image open_reduced(const ViewSource& source, Index factor) {
  return open_part(source, [&](const RasterInfo& info) {
    if (factor < 1 || factor > std::min(info.width, info.height))
      throw IoError(source.file.string() + ": " + std::to_string(info.width) + " x " +
                    std::to_string(info.height) + " px to be reduced " + std::to_string(factor) +
                    " times, expected at least one pixel to be left");
    return Part{{0, 0, info.width / factor * factor, info.height / factor * factor}, factor};
  });
}

void limit_block_cache(std::size_t bytes) {
  if (std::getenv("GDAL_CACHEMAX") == nullptr) GDALSetCacheMax64(static_cast<GIntBig>(bytes));
}

Image open_view(const fs::path& path, const std::vector<fs::path>& image_dirs) {
  return open_view(find_view(path, image_dirs));
}

RasterInfo view_info(const fs::path& path, const std::vector<fs::path>& image_dirs) {
  const ViewSource source = find_view(path, image_dirs);
  RasterInfo info = read_info(source.raster);
  complete(info, source);
  return info;
}

RgbChoice rgb_choice(const Image& image) {
  Dims dim("to_rgb");
  dim.match("pixels", image.pixels, "C H W").match("valid", image.valid, "H W");
  const Index C = dim["C"];
  const std::array<Index, 3> channels =
      C < 3 ? std::array<Index, 3>{0, 0, 0} : image.info.rgb_channels;
  for (const Index c : channels)
    if (c < 0 || c >= C)
      throw ShapeError("to_rgb: channel " + std::to_string(c) + " of an image of " +
                       std::to_string(C) + " channels");
  const auto [low, high] =
      image.info.dtype == "uint8" ? std::pair{0.0F, 255.0F} : stretch_of(image, channels);
  return {channels, low, high};
}

Tensor to_rgb(const Image& image) { return to_rgb(image, rgb_choice(image)); }

Tensor to_rgb(const Image& image, const RgbChoice& choice) {
  Dims dim("to_rgb");
  dim.match("pixels", image.pixels, "C H W").match("valid", image.valid, "H W");
  const auto [channels, low, high] = choice;
  for (const Index c : channels)
    if (c < 0 || c >= dim["C"])
      throw ShapeError("to_rgb: channel " + std::to_string(c) + " of " + std::to_string(dim["C"]) +
                       ", expected one there is");
  const Index H = image.pixels.dim(1), W = image.pixels.dim(2), N = H * W;
  const float scale = high > low ? 1 / (high - low) : 0;
  auto rgb = Tensor::uninitialised({3, H, W});
  for_range(3 * N, Index{1} << 16, [&, channels = channels, low = low](Index begin, Index end) {
    for (Index i = begin; i < end; ++i) {
      const Index c = channels[static_cast<std::size_t>(i / N)], at = i % N;
      const float v = (image.pixels[c * N + at] - low) * scale;
      rgb[i] = image.valid[at] != 0 ? std::clamp(v, 0.0F, 1.0F) : 0.0F;
    }
  });
  return rgb;
}

}  // namespace satsurf::rpc

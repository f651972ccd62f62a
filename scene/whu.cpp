// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/whu.h"

#include "satsurf/core/error.h"
#include "satsurf/core/files.h"
#include "satsurf/core/parallel.h"
#include "satsurf/rpc/read.h"
#include "satsurf/scene/view_geometry.h"

#include <algorithm>
#include <array>
#include <bit>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <fstream>
#include <limits>
#include <sstream>
#include <string_view>
#include <utility>

namespace satsurf::scene {
namespace {

namespace fs = std::filesystem;

fs::path file_of(const fs::path& folder, const char* kind, std::size_t view,
                 const std::string& name) {
  return folder / kind / std::to_string(view) / name;
}

/// How many views there are of every place.
/// throws  IoError for fewer than two
std::size_t view_count(const fs::path& folder) {
  std::size_t views = 0;
  while (is_folder(folder / "image" / std::to_string(views))) ++views;
  if (views < 2)
    throw IoError((folder / "image").string() +
                  ": holds the folder 0 alone, expected 0, 1 and so on, one for each view");
  return views;
}

/// throws  IoError naming the view instead of the camera's own error
template <class F>
auto by_camera_of(const View& view, const F& f) {
  try {
    return f();
  } catch (const Error& e) {
    throw IoError(view.label() + ": " + e.what());
  }
}

/// What stands before the values of a PFM file.
struct PfmHeader {
  Index width = 0, height = 0;
  bool little_endian = true;
  std::uintmax_t bytes = 0;  ///< of the header itself
};

template <class T>
bool parse(std::string_view word, T& value) {
  const char* end = word.data() + word.size();
  const auto result = std::from_chars(word.data(), end, value);
  return result.ec == std::errc() && result.ptr == end;
}

/// Three lines: "Pf", width and height, and a scale whose sign tells the byte order.
/// throws  IoError
PfmHeader pfm_header(const fs::path& path, std::string_view begin) {
  PfmHeader header;
  const auto next_line = [&] {
    const std::size_t end = std::min(begin.find('\n', header.bytes), begin.size());
    std::string_view line = begin.substr(header.bytes, end - header.bytes);
    header.bytes = std::min(end + 1, begin.size());
    while (!line.empty() && (line.back() == ' ' || line.back() == '\r')) line.remove_suffix(1);
    return line;
  };
  const auto refuse = [&](const char* which, std::string_view line, const char* expected) {
    throw IoError(path.string() + ": its " + which + " line is '" +
                  std::string(line.substr(0, 40)) + "', expected " + expected);
  };
  if (const auto line = next_line(); line != "Pf")
    refuse("first", line, "'Pf', a PFM file of one channel");
  const auto size = next_line();
  const std::size_t cut = std::min(size.find(' '), size.size());
  const std::string_view rest =
      size.substr(std::min(size.find_first_not_of(' ', cut), size.size()));
  if (!parse(size.substr(0, cut), header.width) || !parse(rest, header.height) ||
      header.width < 1 || header.height < 1)
    refuse("second", size, "width and height");
  const auto scale = next_line();
  double value = 0;
  if (!parse(scale.substr(scale.starts_with('+') ? 1 : 0), value) || !std::isfinite(value) ||
      value == 0)
    refuse("third", scale, "a positive or negative number");
  header.little_endian = value < 0;
  return header;
}

/// Makes heights unknown that are none: those that are not finite, and those as far beyond the
/// camera's range of heights as its middle is from its end, such as the -999 of ground without data.
void forget_impossible(Tensor& heights, const rpc::Rpc& camera) {
  for (float& h : heights.values())
    if (!(std::abs(static_cast<double>(h) - camera.height_off) <= 2 * camera.height_scale))
      h = std::numeric_limits<float>::quiet_NaN();
}

/// The height between four pixels; NaN outside the image and where one of the four is unknown.
double height_between(const Tensor& heights, const rpc::Pixel& p) {
  const Index H = heights.dim(0), W = heights.dim(1);
  if (!(p.x >= 0 && p.y >= 0 && p.x <= static_cast<double>(W - 1) &&
        p.y <= static_cast<double>(H - 1)))
    return std::nan("");
  const auto x0 = static_cast<Index>(p.x), y0 = static_cast<Index>(p.y);
  const Index x1 = std::min(x0 + 1, W - 1), y1 = std::min(y0 + 1, H - 1);
  const double u = p.x - static_cast<double>(x0), v = p.y - static_cast<double>(y0);
  const auto at = [&](Index y, Index x) { return static_cast<double>(heights[y * W + x]); };
  return (1 - v) * ((1 - u) * at(y0, x0) + u * at(y0, x1)) +
         v * ((1 - u) * at(y1, x0) + u * at(y1, x1));
}

/// The height of the ground at a longitude and latitude that an image of heights shows.
/// z  to begin with
double height_at(const Tensor& heights, const rpc::Rpc& camera,
                 const std::array<double, 2>& lon_lat, double z) {
  constexpr int kMost = 20;        // ground as steep as half the ray: each halves what is missing
  constexpr double kStill = 0.01;  // m
  for (int i = 0; i < kMost; ++i) {
    const double before = z;
    z = height_between(heights, camera.project({lon_lat[0], lon_lat[1], z}));
    if (std::isnan(z) || std::abs(z - before) < kStill) return z;
  }
  return std::nan("");
}

/// The lowest, the middle and the highest of the known heights; empty if none is known.
std::vector<float> low_median_high(const Tensor& heights) {
  std::vector<float> known;
  for (const float h : heights.values())
    if (std::isfinite(h)) known.push_back(h);
  if (known.empty()) return {};
  const auto middle = known.begin() + static_cast<std::ptrdiff_t>(known.size() / 2);
  std::nth_element(known.begin(), middle, known.end());
  return {*std::min_element(known.begin(), middle + 1), *middle,
          *std::max_element(middle, known.end())};
}

}  // namespace

bool is_whu(const fs::path& folder) { return is_folder(folder / "image" / "0"); }

std::set<std::string> whu_scenes(const fs::path& folder) {
  std::set<std::string> names;
  const std::size_t views = view_count(folder);
  for (std::size_t v = 0; v < views; ++v)
    for (const fs::path& entry : entries_of(file_of(folder, "image", v, ""), "images"))
      if (entry.extension() == ".png") names.insert(entry.stem().string());
  if (names.empty())
    throw IoError(folder.string() + ": holds no scenes, expected images named image/0/NAME.png");
  return names;
}

std::vector<View> whu_views(const fs::path& folder, const std::string& name) {
  std::vector<View> views(view_count(folder));
  for (std::size_t v = 0; v < views.size(); ++v) {
    const fs::path file = file_of(folder, "image", v, name + ".png"),
                   camera = file_of(folder, "rpc", v, name + ".rpc");
    require_file(file, "an image of each view of " + name);
    if (!path_exists(camera))
      throw IoError(file.string() + ": no camera (RPC), looked for " + camera.string());
    rpc::Image image = rpc::read_image(file);
    image.info.rpc = rpc::read_rpc_file(camera);
    image.info.files.push_back(camera);
    views[v] = view_of(image, file);
    views[v].name = name + "_" + std::to_string(v);
  }
  return views;
}

Tensor read_pfm(const fs::path& path, Index height, Index width) {
  require_file(path, "a PFM file of heights");
  std::error_code trouble;
  const std::uintmax_t size = fs::file_size(path, trouble);
  std::ifstream in(path, std::ios::binary);
  std::array<char, 128> begin{};  // longer than any header
  in.read(begin.data(), begin.size());
  if (trouble || in.bad() || (in.gcount() == 0 && size > 0))
    throw IoError(path.string() + ": cannot be read, expected a PFM file of heights");
  const PfmHeader header = pfm_header(path, {begin.data(), static_cast<std::size_t>(in.gcount())});
  std::ostringstream text;
  if (header.height != height || header.width != width) {
    text << path.string() << ": " << header.width << " x " << header.height << " px, expected "
         << width << " x " << height << " as its image has";
    throw IoError(text.str());
  }
  const auto bytes = static_cast<std::uintmax_t>(height * width) * sizeof(float);
  if (size - header.bytes != bytes) {
    text << path.string() << ": " << size - header.bytes << " bytes behind its header, expected "
         << bytes << " of " << width << " x " << height << " px";
    throw IoError(text.str());
  }

  auto values = Tensor::uninitialised({height, width});
  in.clear();  // a small file ends within the bytes that were looked at
  in.seekg(static_cast<std::streamoff>(header.bytes));
  for (Index y = height - 1; y >= 0; --y)
    in.read(reinterpret_cast<char*>(values.data() + y * width),
            static_cast<std::streamsize>(sizeof(float)) * width);
  if (!in) throw IoError(path.string() + ": ends early, expected the heights of its header");
  if (header.little_endian != (std::endian::native == std::endian::little))
    for (float& v : values.values()) {
      const auto b = std::bit_cast<std::uint32_t>(v);
      v = std::bit_cast<float>(b >> 24 | (b >> 8 & 0xff00U) | (b << 8 & 0xff0000U) | b << 24);
    }
  return values;
}

rpc::GeoRaster surface_of_view(const Tensor& heights, const rpc::Rpc& camera,
                               const rpc::UtmZone& zone) {
  const Index H = heights.dim(0), W = heights.dim(1);
  const std::vector<float> range = low_median_high(heights);
  if (range.empty()) throw Error("surface_of_view: no height is known, expected some");
  const auto median = static_cast<double>(range[1]);
  const double step = view_angles(camera, W, H, median).gsd;
  double west = INFINITY, south = INFINITY, east = -INFINITY, north = -INFINITY;
  for (const float h : {range[0], range[2]})
    for (const auto& [x, y] : footprint(camera, W, H, zone, static_cast<double>(h))) {
      west = std::min(west, x), east = std::max(east, x);
      south = std::min(south, y), north = std::max(north, y);
    }
  // Cells at whole multiples of their size are where reconstructions have theirs.
  const double x0 = std::floor(west / step), y0 = std::ceil(north / step),
               columns = std::ceil(east / step) - x0, rows = y0 - std::floor(south / step);
  // An image that lies askew takes two cells for a pixel, one of mountains seen aslant some more.
  const double most = 16.0 * static_cast<double>((H + 1) * (W + 1));
  if (!(step > 0 && columns >= 1 && rows >= 1 && columns * rows <= most)) {
    std::ostringstream text;
    text << "surface_of_view: an image of " << W << " x " << H << " px spread over " << columns
         << " x " << rows << " cells of " << step << " m by heights from " << range[0] << " to "
         << range[2] << " m, expected at most 16 for a pixel";
    throw Error(text.str());
  }

  rpc::GeoRaster surface;
  surface.grid = {zone.epsg(), x0 * step, y0 * step, step};
  const auto h = static_cast<Index>(rows), w = static_cast<Index>(columns);
  surface.values = Tensor::uninitialised({h, w});
  for_range(h, 8, [&](Index begin, Index end) {
    for (Index i = begin; i < end; ++i)
      for (Index j = 0; j < w; ++j) {
        const auto lon_lat =
            rpc::geodetic_from_utm(zone, (x0 + static_cast<double>(j) + 0.5) * step,
                                   (y0 - static_cast<double>(i) - 0.5) * step);
        surface.values[i * w + j] = static_cast<float>(height_at(heights, camera, lon_lat, median));
      }
  });
  return surface;
}

WhuTruth whu_truth(const fs::path& folder, const std::string& name, const std::vector<View>& views,
                   const rpc::UtmZone& zone) {
  std::optional<std::size_t> steepest;  // which hides least of the ground
  double least = INFINITY;
  for (std::size_t v = 0; v < views.size(); ++v) {
    if (!path_exists(file_of(folder, "height", v, name + ".pfm"))) continue;
    const View& view = views[v];
    const double off_nadir = by_camera_of(view, [&] {
      return view_angles(view.rpc, view.width(), view.height(), view.rpc.height_off).off_nadir_deg;
    });
    if (!steepest || off_nadir < least) steepest = v, least = off_nadir;
  }
  WhuTruth truth{file_of(folder, "height", steepest.value_or(0), name + ".pfm"), {}};
  if (!steepest) return truth;
  const View& view = views[*steepest];
  Tensor heights = read_pfm(truth.file, view.height(), view.width());
  forget_impossible(heights, view.rpc);
  if (std::none_of(heights.values().begin(), heights.values().end(),
                   [](float h) { return std::isfinite(h); })) {
    std::ostringstream text;
    text << truth.file.string() << ": no height within " << 2 * view.rpc.height_scale
         << " m of its camera's " << view.rpc.height_off << " m, expected some";
    throw IoError(text.str());
  }
  truth.surface = by_camera_of(view, [&] { return surface_of_view(heights, view.rpc, zone); });
  return truth;
}

}  // namespace satsurf::scene

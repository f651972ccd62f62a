// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/user_images.h"

#include "satsurf/scene/height_range.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <utility>

namespace satsurf::scene {
namespace {

namespace fs = std::filesystem;

/// Source of a range that is not used as it is, but searched.
constexpr const char* kCameraRange = "of the cameras";

std::string kilometres(double metres) {
  char text[32];
  std::snprintf(text, sizeof text, "%.1f km", metres / 1000);
  return text;
}

std::string span_text(const rpc::HeightRange& range) {
  char text[80];
  std::snprintf(text, sizeof text, "%.6g to %.6g m", range.low, range.high);
  return text;
}

/// Unique short names for output files: the file's stem, numbered where two are the same.
std::string view_name(const fs::path& file, const std::vector<View>& taken) {
  const std::string stem = file.stem().string();
  const auto is_taken = [&](const std::string& n) {
    return std::any_of(taken.begin(), taken.end(), [&](const View& v) { return v.name == n; });
  };
  std::string name = stem;
  for (int k = 2; is_taken(name); ++k) name = stem + "_" + std::to_string(k);
  return name;
}

/// Heights a camera was made for.
rpc::HeightRange box_of(const rpc::Rpc& rpc) {
  return {rpc.height_off - std::abs(rpc.height_scale), rpc.height_off + std::abs(rpc.height_scale)};
}

/// Overlap of the heights the cameras were made for; not a range (low >= high) where they share
/// none.
rpc::HeightRange camera_range(const std::vector<View>& views) {
  rpc::HeightRange all{-INFINITY, INFINITY};
  for (const View& v : views) {
    const rpc::HeightRange box = box_of(v.rpc);
    all = {std::max(all.low, box.low), std::min(all.high, box.high)};
  }
  return all;
}

/// throws IoError for an image in which nothing can be found again
void check_image(const View& view) {
  constexpr Index kSmallest = 16;  // px; two windows of the coarse comparison
  constexpr double kFlat = 0.5 / 255;
  const Index H = view.rgb.dim(1), W = view.rgb.dim(2), P = H * W;
  if (std::min(H, W) < kSmallest)
    throw IoError(view.file.string() + ": " + std::to_string(W) + " x " + std::to_string(H) +
                  " px, expected at least " + std::to_string(kSmallest) + " x " +
                  std::to_string(kSmallest));
  double sum = 0, squares = 0, count = 0;
  for (Index i = 0; i < P; ++i) {
    if (view.valid[i] <= 0) continue;
    const double grey =
        static_cast<double>(view.rgb[i] + view.rgb[P + i] + view.rgb[2 * P + i]) / 3;
    sum += grey, squares += grey * grey, count += 1;
  }
  if (squares / count - sum / count * sum / count < kFlat * kFlat)
    throw IoError(view.file.string() +
                  ": the same grey everywhere, expected an image with texture to compare");
}

/// throws ConfigError for a range that lies mostly outside the heights a camera was made for
void check_wanted(const rpc::HeightRange& wanted, const std::vector<View>& views) {
  constexpr double kSlack = 200;  // m; a box cut to flat ground still lets a tower be asked for
  for (const View& v : views) {
    const rpc::HeightRange box = box_of(v.rpc);
    const double common = std::min(wanted.high, box.high) - std::max(wanted.low, box.low);
    if (common > 0 && (common >= 0.5 * (wanted.high - wanted.low) ||
                       (wanted.low >= box.low - kSlack && wanted.high <= box.high + kSlack)))
      continue;
    throw ConfigError("--height-range: " + span_text(wanted) +
                      ", expected heights that the camera of " + v.file.string() +
                      " is made for, " + span_text(box));
  }
}

/// throws Error for two images from one point of view, which carry no height
void check_parallax(const View& a, const View& b, const rpc::UtmZone& zone,
                    const std::array<double, 2>& ground, double h) {
  constexpr double kLeast = 1e-3;  // px per m; a tenth of a pixel for a tower of 100 m
  const auto lon_lat = rpc::geodetic_from_utm(zone, ground[0], ground[1]);
  const double px = parallax(a.rpc, b.rpc, {lon_lat[0], lon_lat[1], h});
  if (px >= kLeast) return;
  char text[32];
  std::snprintf(text, sizeof text, "%.2g px/m", px);
  throw Error("reconstruct: " + a.file.string() + " and " + b.file.string() +
              " are seen from one direction (parallax " + text +
              "), expected different ones; leave one of them out");
}

/// A height among those both cameras are made for at which two images see common ground.
std::optional<double> height_of_overlap(const View& a, const View& b, const rpc::UtmZone& zone) {
  constexpr int kTried = 65;
  const rpc::HeightRange box = camera_range({a, b});
  for (int k = 0; k < kTried && box.low < box.high; ++k) {
    const double h = box.low + (box.high - box.low) * k / (kTried - 1);
    const auto ground = [&](const View& v) {
      return footprint(v.rpc, v.rgb.dim(2), v.rgb.dim(1), zone, h);
    };
    if (!intersect(ground(a), ground(b)).empty()) return h;
  }
  return std::nullopt;
}

/// The views of a scene, and what their metadata say of heights.
struct Views {
  std::vector<View> views;
  std::optional<rpc::HeightRange> named;  ///< union of the ranges they name
};

/// throws IoError
Views read_views(const std::vector<fs::path>& files, const std::vector<fs::path>& image_dirs,
                 const std::function<void()>& poll) {
  Views out;
  for (const fs::path& file : files) {
    if (poll) poll();
    const rpc::Image image = rpc::open_view(file, image_dirs);
    View view = view_of(image, file);
    view.name = view_name(file, out.views);
    if (const auto& range = image.info.height_range) {
      if (!out.named) out.named = range;
      out.named->low = std::min(out.named->low, range->low),
      out.named->high = std::max(out.named->high, range->high);
    }
    check_image(view);
    out.views.push_back(std::move(view));
  }
  return out;
}

/// throws ConfigError for a wanted range that is not the cameras'
RangeChoice choose_range(const std::optional<rpc::HeightRange>& wanted,
                         const std::optional<rpc::HeightRange>& named,
                         const std::vector<View>& views) {
  if (wanted) {
    check_wanted(*wanted, views);
    return {*wanted, "as given"};
  }
  if (named && named->low < named->high) return {*named, "from the images' metadata"};
  return {camera_range(views), kCameraRange};
}

bool usable(const rpc::HeightRange& range) { return range.low < range.high; }

/// Where a view is put on the ground: the middle of the range; of its own heights without one.
double height_of(const View& view, const rpc::HeightRange& range) {
  return usable(range) ? (range.low + range.high) / 2 : view.rpc.height_off;
}

rpc::Geodetic centre_of(const View& view, const rpc::HeightRange& range) {
  return view.rpc.localize(
      {static_cast<double>(view.rgb.dim(2)) / 2, static_cast<double>(view.rgb.dim(1)) / 2},
      height_of(view, range));
}

/// What each view covers.
/// throws Error for views so far apart that one zone does not hold both
std::vector<Polygon> footprints(const std::vector<View>& views, const rpc::UtmZone& zone,
                                const rpc::HeightRange& range) {
  const rpc::Geodetic centre = centre_of(views[0], range);
  std::vector<Polygon> ground;
  for (const View& view : views) {
    // far apart is told in the words of the overlap check, not in those of a projection out of its
    // zone
    const rpc::Geodetic c = centre_of(view, range);
    const double dlon = std::remainder(c.lon - centre.lon, 360), dlat = c.lat - centre.lat;
    if (std::hypot(dlon * std::cos(centre.lat * M_PI / 180), dlat) > 3)
      throw Error("reconstruct: " + views[0].file.string() + " and " + view.file.string() +
                  " do not overlap on the ground, expected images of one place");
    ground.push_back(
        footprint(view.rpc, view.rgb.dim(2), view.rgb.dim(1), zone, height_of(view, range)));
  }
  return ground;
}

/// Says why two views have no common ground.
/// ground_a, ground_b  what each covers
/// wanted              the range that was asked for, if one was
[[noreturn]] void refuse_apart(const View& a, const View& b, const Polygon& ground_a,
                               const Polygon& ground_b, const rpc::UtmZone& zone,
                               const std::optional<rpc::HeightRange>& wanted) {
  if (wanted)
    if (const auto h = height_of_overlap(a, b, zone)) {
      char near[32];
      std::snprintf(near, sizeof near, "%.0f m", *h);
      throw ConfigError("--height-range: " + span_text(*wanted) + ", but " + a.file.string() +
                        " and " + b.file.string() +
                        " see no common ground at these heights (they do at " + near +
                        "), expected the heights of the ground");
    }
  const auto centre_a = polygon_centroid(ground_a), centre_b = polygon_centroid(ground_b);
  throw Error("reconstruct: " + a.file.string() + " and " + b.file.string() +
              " do not overlap on the ground (centres " +
              kilometres(std::hypot(centre_a[0] - centre_b[0], centre_a[1] - centre_b[1])) +
              " apart), expected images of one place");
}

/// throws Error, ConfigError for a pair without common ground or parallax
void check_overlaps(const std::vector<View>& views, const std::vector<Polygon>& ground,
                    const rpc::UtmZone& zone, const rpc::HeightRange& range,
                    const std::optional<rpc::HeightRange>& wanted) {
  for (std::size_t i = 0; i < views.size(); ++i)
    for (std::size_t j = i + 1; j < views.size(); ++j) {
      const Polygon both = intersect(ground[i], ground[j]);
      if (both.empty()) refuse_apart(views[i], views[j], ground[i], ground[j], zone, wanted);
      check_parallax(views[i], views[j], zone, polygon_centroid(both), height_of(views[i], range));
    }
}

}  // namespace

Polygon footprint(const rpc::Rpc& rpc, Index width, Index height, const rpc::UtmZone& zone,
                  double h) {
  const double right = static_cast<double>(width) - 0.5, bottom = static_cast<double>(height) - 0.5;
  Polygon corners;
  for (const rpc::Pixel p :
       {rpc::Pixel{-0.5, -0.5}, {-0.5, bottom}, {right, bottom}, {right, -0.5}}) {
    const rpc::Geodetic g = rpc.localize(p, h);
    corners.push_back(rpc::utm_from_geodetic(zone, g.lon, g.lat));
  }
  return counter_clockwise(std::move(corners));
}

ViewAngles view_angles(const rpc::Rpc& rpc, Index width, Index height, double h) {
  const rpc::Pixel centre{(static_cast<double>(width) - 1) / 2,
                          (static_cast<double>(height) - 1) / 2};
  const rpc::Geodetic g = rpc.localize(centre, h);
  rpc::LocalFrame frame;
  frame.zone = rpc::utm_zone_of(g.lon, g.lat);
  const auto utm = rpc::utm_from_geodetic(frame.zone, g.lon, g.lat);
  frame.easting0 = utm[0], frame.northing0 = utm[1], frame.h0 = h;
  // central differences over a metre: the camera is smooth far beyond that
  std::array<std::array<double, 3>, 2> jacobian{};
  for (std::size_t axis = 0; axis < 3; ++axis) {
    std::array<double, 3> p{0, 0, 0};
    p[axis] = 1;
    const rpc::Pixel up = rpc.project(frame.geodetic_from_local(p));
    p[axis] = -1;
    const rpc::Pixel down = rpc.project(frame.geodetic_from_local(p));
    jacobian[0][axis] = (up.x - down.x) / 2, jacobian[1][axis] = (up.y - down.y) / 2;
  }
  const rpc::ViewGeometry geometry = rpc::view_geometry(jacobian);
  const double east = geometry.direction[0], north = geometry.direction[1];
  const double azimuth = std::atan2(east, north) * 180 / M_PI;
  return {geometry.footprint, std::atan(std::hypot(east, north)) * 180 / M_PI,
          azimuth < 0 ? azimuth + 360 : azimuth};
}

double parallax(const rpc::Rpc& a, const rpc::Rpc& b, const rpc::Geodetic& p) {
  const rpc::Pixel in_a = a.project(p);
  const rpc::Pixel low = b.project(a.localize(in_a, p.h - 0.5)),
                   high = b.project(a.localize(in_a, p.h + 0.5));
  return std::hypot(high.x - low.x, high.y - low.y);
}

UserScene scene_from_views(const std::vector<fs::path>& files,
                           const std::vector<fs::path>& image_dirs,
                           const std::optional<rpc::HeightRange>& wanted,
                           const std::function<void()>& poll) {
  if (files.empty()) throw Error("reconstruct: no image, expected two or more");
  if (files.size() == 1)
    throw Error("reconstruct: " + files[0].string() + " is the only image, expected two or more");
  UserScene out;
  Scene& scene = out.scene;
  Views read = read_views(files, image_dirs, poll);
  out.range = choose_range(wanted, read.named, read.views);
  scene.views = std::move(read.views);
  const rpc::HeightRange first = out.range.range;  // what can be known before comparing images

  const rpc::Geodetic centre = centre_of(scene.views[0], first);
  scene.frame.zone = rpc::utm_zone_of(centre.lon, centre.lat);
  const std::vector<Polygon> ground = footprints(scene.views, scene.frame.zone, first);
  check_overlaps(scene.views, ground, scene.frame.zone, first, wanted);
  Polygon common = ground[0];
  for (const Polygon& g : ground) common = intersect(common, g);
  out.common_area = common.empty() ? 0 : polygon_area(common);
  const auto origin = polygon_centroid(common.empty() ? ground[0] : common);
  scene.frame.easting0 = std::round(origin[0]), scene.frame.northing0 = std::round(origin[1]);
  if (!usable(first))  // told after the overlap: images of two places seldom share a range either
    throw Error("reconstruct: " + files[0].string() +
                " and the others: cameras for different heights, expected a range "
                "they share; give --height-range");
  scene.frame.h0 = std::round((first.low + first.high) / 2);
  scene.name = scene.views[0].name;

  if (out.range.source == kCameraRange) {
    const auto [low, high] =
        find_height_range(scene, first.low - scene.frame.h0, first.high - scene.frame.h0, poll);
    out.range = {{low + scene.frame.h0, high + scene.frame.h0}, "found by comparing the images"};
    scene.frame.h0 = std::round((out.range.range.low + out.range.range.high) / 2);
  }
  scene.z_low = out.range.range.low - scene.frame.h0;
  scene.z_high = out.range.range.high - scene.frame.h0;
  return out;
}

}  // namespace satsurf::scene

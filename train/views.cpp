// SPDX-License-Identifier: Apache-2.0
#include "satsurf/train/views.h"

#include "satsurf/train/reconstruct.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace satsurf::train {
namespace {

namespace fs = std::filesystem;

double cross(const std::array<double, 2>& o, const std::array<double, 2>& a,
             const std::array<double, 2>& b) {
  return (a[0] - o[0]) * (b[1] - o[1]) - (a[1] - o[1]) * (b[0] - o[0]);
}

/// Twice the signed area, positive counter-clockwise, measured from the first corner to keep
/// digits.
double signed_area2(const Polygon& p) {
  double sum = 0;
  for (std::size_t i = 1; i + 1 < p.size(); ++i) sum += cross(p[0], p[i], p[i + 1]);
  return sum;
}

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
std::string view_name(const fs::path& file, const std::vector<SceneView>& taken) {
  const std::string stem = file.stem().string();
  const auto is_taken = [&](const std::string& n) {
    return std::any_of(taken.begin(), taken.end(), [&](const SceneView& v) { return v.name == n; });
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
rpc::HeightRange camera_range(const std::vector<SceneView>& views) {
  rpc::HeightRange all{-INFINITY, INFINITY};
  for (const SceneView& v : views) {
    const rpc::HeightRange box = box_of(v.rpc);
    all = {std::max(all.low, box.low), std::min(all.high, box.high)};
  }
  return all;
}

/// throws IoError for an image in which nothing can be found again
void check_image(const SceneView& view) {
  constexpr Index kSmallest = 16;  // px; two windows of the coarse comparison
  constexpr double kFlat = 0.5 / 255;
  const Index H = view.rgb.dim(1), W = view.rgb.dim(2), P = H * W;
  if (std::min(H, W) < kSmallest)
    throw IoError(view.file.string() + ": " + std::to_string(W) + " x " + std::to_string(H) +
                  " px, wanted at least " + std::to_string(kSmallest) + " x " +
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
                  ": the same grey everywhere, wanted an image with texture to compare");
}

/// throws ConfigError for a range that lies mostly outside the heights a camera was made for
void check_wanted(const rpc::HeightRange& wanted, const std::vector<SceneView>& views) {
  constexpr double kSlack = 200;  // m; a box cut to flat ground still lets a tower be asked for
  for (const SceneView& v : views) {
    const rpc::HeightRange box = box_of(v.rpc);
    const double common = std::min(wanted.high, box.high) - std::max(wanted.low, box.low);
    if (common > 0 && (common >= 0.5 * (wanted.high - wanted.low) ||
                       (wanted.low >= box.low - kSlack && wanted.high <= box.high + kSlack)))
      continue;
    throw ConfigError("--height-range: " + span_text(wanted) +
                      ", wanted heights that the camera of " + v.file.string() + " is made for, " +
                      span_text(box));
  }
}

/// throws Error for two images from one point of view, which carry no height
void check_parallax(const SceneView& a, const SceneView& b, const rpc::UtmZone& zone,
                    const std::array<double, 2>& ground, double h) {
  constexpr double kLeast = 1e-3;  // px per m; a tenth of a pixel for a tower of 100 m
  const auto lon_lat = rpc::geodetic_from_utm(zone, ground[0], ground[1]);
  const double px = parallax(a.rpc, b.rpc, {lon_lat[0], lon_lat[1], h});
  if (px >= kLeast) return;
  char text[32];
  std::snprintf(text, sizeof text, "%.2g px/m", px);
  throw Error("reconstruct: " + a.file.string() + " and " + b.file.string() +
              " are seen from one direction (parallax " + text +
              "), wanted different ones; leave one of them out");
}

/// A height among those both cameras are made for at which two images see common ground.
std::optional<double> height_of_overlap(const SceneView& a, const SceneView& b,
                                        const rpc::UtmZone& zone) {
  constexpr int kTried = 65;
  const rpc::HeightRange box = camera_range({a, b});
  for (int k = 0; k < kTried && box.low < box.high; ++k) {
    const double h = box.low + (box.high - box.low) * k / (kTried - 1);
    const auto ground = [&](const SceneView& v) {
      return footprint(v.rpc, v.rgb.dim(2), v.rgb.dim(1), zone, h);
    };
    if (!intersect(ground(a), ground(b)).empty()) return h;
  }
  return std::nullopt;
}

}  // namespace

double polygon_area(const Polygon& polygon) { return std::abs(signed_area2(polygon)) / 2; }

std::array<double, 2> polygon_centroid(const Polygon& p) {
  double x = 0, y = 0, area = 0;
  for (std::size_t i = 1; i + 1 < p.size(); ++i) {
    const double a = cross(p[0], p[i], p[i + 1]);
    area += a;
    x += a * ((p[i][0] - p[0][0]) + (p[i + 1][0] - p[0][0])) / 3;
    y += a * ((p[i][1] - p[0][1]) + (p[i + 1][1] - p[0][1])) / 3;
  }
  if (area == 0) throw Error("polygon_centroid: no area, wanted a polygon");
  return {p[0][0] + x / area, p[0][1] + y / area};
}

Polygon intersect(const Polygon& a, const Polygon& b) {
  Polygon out = a;
  for (std::size_t i = 0; i < b.size() && !out.empty(); ++i) {
    const auto &from = b[i], &to = b[(i + 1) % b.size()];
    Polygon kept;
    for (std::size_t k = 0; k < out.size(); ++k) {
      const auto &p = out[k], &q = out[(k + 1) % out.size()];
      const double sp = cross(from, to, p), sq = cross(from, to, q);
      if (sp >= 0) kept.push_back(p);
      if ((sp > 0 && sq < 0) || (sp < 0 && sq > 0)) {
        const double t = sp / (sp - sq);
        kept.push_back({p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1])});
      }
    }
    out = std::move(kept);
  }
  if (out.size() < 3 || polygon_area(out) <= 0) out.clear();
  return out;
}

Polygon footprint(const rpc::Rpc& rpc, Index width, Index height, const rpc::UtmZone& zone,
                  double h) {
  const double right = static_cast<double>(width) - 0.5, bottom = static_cast<double>(height) - 0.5;
  Polygon corners;
  for (const rpc::Pixel p :
       {rpc::Pixel{-0.5, -0.5}, {-0.5, bottom}, {right, bottom}, {right, -0.5}}) {
    const rpc::Geodetic g = rpc.localize(p, h);
    corners.push_back(rpc::utm_from_geodetic(zone, g.lon, g.lat));
  }
  if (signed_area2(corners) < 0) std::reverse(corners.begin(), corners.end());
  return corners;
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
  if (files.empty()) throw Error("reconstruct: no image, wanted two or more");
  if (files.size() == 1)
    throw Error("reconstruct: " + files[0].string() + " is the only image, wanted two or more");
  UserScene out;
  Scene& scene = out.scene;
  std::optional<rpc::HeightRange> named;
  for (const fs::path& file : files) {
    if (poll) poll();
    const rpc::Image image = rpc::open_view(file, image_dirs);
    SceneView view;
    view.file = file;
    view.name = view_name(file, scene.views);
    view.rgb = rpc::to_rgb(image);
    view.valid = image.valid;
    view.rpc = *image.info.rpc;
    view.sun_elevation_deg = image.info.sun_elevation_deg.value_or(0);
    view.sun_azimuth_deg = image.info.sun_azimuth_deg.value_or(0);
    view.date = image.info.acquisition_date.value_or("");
    if (const auto& range = image.info.height_range) {
      if (!named) named = range;
      named->low = std::min(named->low, range->low),
      named->high = std::max(named->high, range->high);
    }
    check_image(view);
    scene.views.push_back(std::move(view));
  }

  if (wanted) check_wanted(*wanted, scene.views);
  if (wanted)
    out.range = {*wanted, "as given"};
  else if (named && named->low < named->high)
    out.range = {*named, "from the images' metadata"};
  else
    out.range = {camera_range(scene.views), "of the cameras"};
  const bool usable = out.range.range.low < out.range.range.high;
  const double middle =
      usable ? (out.range.range.low + out.range.range.high) / 2 : scene.views[0].rpc.height_off;
  const auto height_of = [&](const SceneView& v) { return usable ? middle : v.rpc.height_off; };

  const auto centre_of = [&](const SceneView& v) {
    return v.rpc.localize(
        {static_cast<double>(v.rgb.dim(2)) / 2, static_cast<double>(v.rgb.dim(1)) / 2},
        height_of(v));
  };
  const rpc::Geodetic centre = centre_of(scene.views[0]);
  scene.frame.zone = rpc::utm_zone_of(centre.lon, centre.lat);
  std::vector<Polygon> ground;
  for (std::size_t i = 0; i < files.size(); ++i) {
    // far apart is told in the words of the overlap check, not in those of a projection out of its
    // zone
    const rpc::Geodetic c = centre_of(scene.views[i]);
    const double dlon = std::remainder(c.lon - centre.lon, 360), dlat = c.lat - centre.lat;
    if (std::hypot(dlon * std::cos(centre.lat * M_PI / 180), dlat) > 3)
      throw Error("reconstruct: " + files[0].string() + " and " + files[i].string() +
                  " do not overlap on the ground, wanted images of one place");
    ground.push_back(footprint(scene.views[i].rpc, scene.views[i].rgb.dim(2),
                               scene.views[i].rgb.dim(1), scene.frame.zone,
                               height_of(scene.views[i])));
  }
  Polygon common = ground[0];
  for (std::size_t i = 0; i < files.size(); ++i) {
    common = intersect(common, ground[i]);
    for (std::size_t j = i + 1; j < files.size(); ++j) {
      if (const Polygon both = intersect(ground[i], ground[j]); !both.empty()) {
        check_parallax(scene.views[i], scene.views[j], scene.frame.zone, polygon_centroid(both),
                       usable ? middle : scene.views[i].rpc.height_off);
        continue;
      }
      if (wanted)
        if (const auto h = height_of_overlap(scene.views[i], scene.views[j], scene.frame.zone)) {
          char near[32];
          std::snprintf(near, sizeof near, "%.0f m", *h);
          throw ConfigError("--height-range: " + span_text(*wanted) + ", but " + files[i].string() +
                            " and " + files[j].string() +
                            " see no common ground at these heights (they do at " + near +
                            "), wanted the heights of the ground");
        }
      const auto a = polygon_centroid(ground[i]), b = polygon_centroid(ground[j]);
      throw Error("reconstruct: " + files[i].string() + " and " + files[j].string() +
                  " do not overlap on the ground (centres " +
                  kilometres(std::hypot(a[0] - b[0], a[1] - b[1])) +
                  " apart), wanted images of one place");
    }
  }
  out.common_area = common.empty() ? 0 : polygon_area(common);
  const auto origin = polygon_centroid(common.empty() ? ground[0] : common);
  scene.frame.easting0 = std::round(origin[0]), scene.frame.northing0 = std::round(origin[1]);
  if (!usable)  // told after the overlap: images of two places seldom share a range either
    throw Error("reconstruct: " + files[0].string() +
                " and the others: cameras for different heights, wanted a range "
                "they share; give --height-range");
  scene.frame.h0 = std::round(middle);
  scene.name = scene.views[0].name;

  if (!wanted && out.range.source == "of the cameras") {
    const auto [low, high] = find_height_range(scene, out.range.range.low - scene.frame.h0,
                                               out.range.range.high - scene.frame.h0, poll);
    out.range = {{low + scene.frame.h0, high + scene.frame.h0}, "found by comparing the images"};
    scene.frame.h0 = std::round((out.range.range.low + out.range.range.high) / 2);
  }
  scene.z_low = out.range.range.low - scene.frame.h0;
  scene.z_high = out.range.range.high - scene.frame.h0;
  return out;
}

}  // namespace satsurf::train

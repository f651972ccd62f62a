// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/user_images.h"

#include "satsurf/scene/height_range.h"
#include "satsurf/scene/polygon.h"
#include "satsurf/scene/terrain.h"
#include "satsurf/scene/view_geometry.h"
#include "satsurf/scene/view_pair.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <exception>
#include <utility>

namespace satsurf::scene {
namespace {

namespace fs = std::filesystem;

/// Source of a range that is not used as it is, but searched.
constexpr const char* kCameraRange = "of the cameras";
constexpr const char* kMetadataRange = "from the images' metadata";
constexpr const char* kTerrainRange = "from the terrain";

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

/// Unique short names for output files: numbered where two are the same.
std::string view_name(const std::string& stem, const std::vector<View>& taken) {
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
    throw IoError(view.label() + ": " + std::to_string(W) + " x " + std::to_string(H) +
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
    throw IoError(view.label() +
                  ": the same grey everywhere, expected an image with texture to compare");
}

/// throws ConfigError for a range that lies mostly outside the heights a camera was made for
void check_wanted(const rpc::HeightRange& wanted, const std::vector<View>& views) {
  constexpr double kSlack = 200;  // m; a box cut to flat ground still lets a tower be asked for
  for (const View& v : views) {
    const rpc::HeightRange box = box_of(v.rpc);
    const double common = std::min(wanted.high, box.high) - std::max(wanted.low, box.low);
    if (common > 0 && (common >= 0.5 * wanted.span() ||
                       (wanted.low >= box.low - kSlack && wanted.high <= box.high + kSlack)))
      continue;
    throw ConfigError("height range: " + span_text(wanted) +
                      ", expected heights that the camera of " + v.label() + " is made for, " +
                      span_text(box));
  }
}

/// throws Error for two images from one point of view, which carry no height
void check_parallax(const View& a, const View& b, const rpc::UtmZone& zone,
                    const std::array<double, 2>& ground, double h) {
  const auto lon_lat = rpc::geodetic_from_utm(zone, ground[0], ground[1]);
  const double px = parallax(a.rpc, b.rpc, {lon_lat[0], lon_lat[1], h});
  if (px >= kLeastParallax) return;
  char text[32];
  std::snprintf(text, sizeof text, "%.2g px/m", px);
  throw Error(a.label() + " and " + b.label() + " are seen from one direction (parallax " + text +
              "), expected different ones; leave one of them out");
}

/// A height among those both cameras are made for at which two images see common ground.
std::optional<double> height_of_overlap(const View& a, const View& b, const rpc::UtmZone& zone) {
  constexpr int kTried = 65;
  const rpc::HeightRange box = camera_range({a, b});
  for (int k = 0; k < kTried && box.has_span(); ++k) {
    const double h = box.low + box.span() * k / (kTried - 1);
    const auto ground = [&](const View& v) {
      return footprint(v.rpc, v.width(), v.height(), zone, h);
    };
    if (!intersect(ground(a), ground(b)).empty()) return h;
  }
  return std::nullopt;
}

/// throws ConfigError for a wanted range that is not the cameras'
RangeChoice choose_range(const std::optional<rpc::HeightRange>& wanted,
                         const std::optional<rpc::HeightRange>& named,
                         const std::vector<View>& views) {
  if (wanted) {
    check_height_range(*wanted);
    check_wanted(*wanted, views);
    return {*wanted, "as given"};
  }
  if (named && named->has_span()) return {*named, kMetadataRange};
  return {camera_range(views), kCameraRange};
}

/// Rectangle around what some polygons hold; without a span where that is nothing.
std::array<double, 4> around(const std::vector<Polygon>& ground) {
  std::array<double, 4> out{INFINITY, INFINITY, -INFINITY, -INFINITY};
  for (const Polygon& polygon : ground)
    for (const auto& [x, y] : polygon)
      out = {std::min(out[0], x), std::min(out[1], y), std::max(out[2], x), std::max(out[3], y)};
  return out;
}

/// Rectangle around what any two views see at some height of a range; small images share ground at
/// few heights of a wide one.
std::array<double, 4> shared_ground(const std::vector<View>& views, const rpc::UtmZone& zone,
                                    const rpc::HeightRange& range) {
  constexpr int kTried = 65;  // heights
  std::vector<Polygon> shared;
  for (int k = 0; k < kTried; ++k) {
    const double h = range.low + range.span() * k / (kTried - 1);
    std::vector<Polygon> ground;
    for (const View& v : views) ground.push_back(footprint(v.rpc, v.width(), v.height(), zone, h));
    for (std::size_t i = 0; i < ground.size(); ++i)
      for (std::size_t j = i + 1; j < ground.size(); ++j)
        shared.push_back(intersect(ground[i], ground[j]));
  }
  return around(shared);
}

/// The range that a model of the terrain says, or why it says none; what was known before otherwise.
/// known  range that the images' metadata or cameras say
RangeChoice choice_by_terrain(const rpc::Terrain& terrain, const RangeChoice& known,
                              const std::vector<View>& views, const rpc::UtmZone& zone) {
  // The ground of all heights of the cameras first, of which the model may know a part, then that of
  // the terrain's own.
  rpc::HeightRange range = known.height_range;
  RangeChoice out = known;
  for (const double least : {0.0, kTerrainKnown}) {
    const std::array<double, 4> ground = shared_ground(views, zone, range);
    if (!(ground[0] < ground[2])) return out;  // which the overlap check has the words for
    const TerrainRange by = terrain_range(terrain, zone, ground, least);
    if (!by.height_range) {
      out = known, out.trouble = by.trouble;
      return out;
    }
    out.height_range = *by.height_range, out.source = kTerrainRange;
    range = {out.height_range.low + kBelowTerrain, out.height_range.high - kAboveTerrain};
    try {
      check_wanted(out.height_range, views);
    } catch (const ConfigError& e) {
      out = known, out.trouble = terrain.path().string() + ": " + e.what();
      return out;
    }
  }
  return out;
}

/// Whether a point of the local frame lies under a mask, by cells of some metres.
std::function<bool(double, double)> under_mask(const rpc::GroundMask& mask, const Scene& scene,
                                               const rpc::HeightRange& range) {
  constexpr double kCells = 1024;  // a side; the images are compared in a quarter of these pixels
  const std::array<double, 4> all = shared_ground(scene.views, scene.frame.zone, range);
  const double side = std::max(all[2] - all[0], all[3] - all[1]), step = side / kCells;
  if (!(side > 0)) return {};
  const auto cells = [&](double length) {
    return std::max<Index>(1, static_cast<Index>(std::ceil(length / step)));
  };
  const Index H = cells(all[3] - all[1]), W = cells(all[2] - all[0]);
  const Tensor covered = mask.on({scene.frame.zone.epsg(), all[0], all[3], step}, H, W);
  const double x0 = all[0] - scene.frame.easting0, y0 = all[3] - scene.frame.northing0;
  return [=](double x, double y) {
    const auto u = static_cast<Index>(std::floor((x - x0) / step)),
               v = static_cast<Index>(std::floor((y0 - y) / step));
    return u >= 0 && v >= 0 && u < W && v < H && covered[v * W + u] > 0;
  };
}

/// throws  Error for a mask that leaves hardly any of the ground that two views see
/// ground  of each view
void check_mask(const rpc::GroundMask& mask, const std::vector<Polygon>& ground,
                const rpc::UtmZone& zone) {
  constexpr double kCells = 256;        // a side
  constexpr double kLeastShare = 0.01;  // of the ground
  std::vector<Polygon> shared;
  for (std::size_t i = 0; i < ground.size(); ++i)
    for (std::size_t j = i + 1; j < ground.size(); ++j)
      if (Polygon both = intersect(ground[i], ground[j]); !both.empty())
        shared.push_back(std::move(both));
  const std::array<double, 4> all = around(shared);
  const double step = std::max(all[2] - all[0], all[3] - all[1]) / kCells;
  if (!(step > 0)) return;
  const auto H = std::max<Index>(1, std::lround((all[3] - all[1]) / step)),
             W = std::max<Index>(1, std::lround((all[2] - all[0]) / step));
  const Tensor covered = mask.on({zone.epsg(), all[0], all[3], step}, H, W);
  double seen = 0, left = 0;
  for (Index i = 0; i < H * W; ++i) {
    const double x = all[0] + (static_cast<double>(i % W) + 0.5) * step,
                 y = all[3] - (static_cast<double>(i / W) + 0.5) * step;
    if (std::ranges::none_of(shared, [&](const Polygon& p) { return contains(p, x, y); })) continue;
    seen += 1, left += covered[i] > 0 ? 0 : 1;
  }
  if (left >= kLeastShare * seen) return;
  char text[240];
  std::snprintf(text, sizeof text,
                "the mask leaves %.2g %% of the ground that two images see, expected 1 %% or more; "
                "--mask takes away all cells of a raster but those of 0 and nodata, --mask-values "
                "those of some values",
                100 * left / seen);
  throw Error(mask.path().string() + ": " + text);
}

/// The heights that comparing the images finds. The first view is compared with the others that see
/// its ground, and so is every further one that sees hardly any ground of those before it.
/// ground  of each view
FoundHeights range_of_all(const Scene& scene, const std::vector<Polygon>& ground,
                          const rpc::HeightRange& searched, const std::function<void()>& poll,
                          const std::function<bool(double, double)>& unwanted) {
  constexpr double kSeen = 0.5;  // of a view's ground that another one speaks for
  std::optional<FoundHeights> all;
  std::exception_ptr trouble;
  std::vector<std::size_t> compared;
  for (std::size_t i = 0; i < ground.size(); ++i) {
    const auto shared = [&](std::size_t j) {
      const Polygon both = intersect(ground[i], ground[j]);
      return both.empty() ? 0 : polygon_area(both) / polygon_area(ground[i]);
    };
    if (std::ranges::any_of(compared, [&](std::size_t j) { return shared(j) >= kSeen; })) continue;
    compared.push_back(i);
    Scene part;
    part.frame = scene.frame;
    part.views.push_back(scene.views[i]);
    for (std::size_t j = 0; j < ground.size(); ++j)
      if (j != i && shared(j) > 0) part.views.push_back(scene.views[j]);
    try {
      const FoundHeights found = find_height_range(part, searched, poll, unwanted);
      all = all ? FoundHeights{hull(all->agreed, found.agreed), hull(all->range, found.range)}
                : found;
    } catch (const Error&) {  // water, say; the others may see more
      if (!trouble) trouble = std::current_exception();
    }
  }
  if (!all) std::rethrow_exception(trouble);
  return *all;
}

/// Where a view is put on the ground: the middle of the range; of its own heights without one.
double height_of(const View& view, const std::optional<rpc::HeightRange>& range) {
  return range && range->has_span() ? range->middle() : view.rpc.height_off;
}

/// Of many views those that are used; all of two, about which `check_overlaps` has the better words.
/// left_out  takes the others
std::vector<View> chosen(std::vector<View> views, const std::optional<rpc::HeightRange>& range,
                         Index most, Together together, std::vector<LeftOut>& left_out) {
  if (views.size() <= 2) return views;
  ViewChoice choice = choose_views(
      views, [&](const View& v) { return height_of(v, range); }, most, together);
  if (choice.kept.empty()) return views;
  std::vector<View> kept;
  for (const Index i : choice.kept) kept.push_back(std::move(views[static_cast<std::size_t>(i)]));
  left_out = std::move(choice.left_out);
  return kept;
}

bool holds(const rpc::HeightRange& range, const std::optional<rpc::HeightRange>& heights) {
  return !heights || (range.low <= heights->low && heights->high <= range.high);
}

rpc::Geodetic centre_of(const View& view, const rpc::HeightRange& range) {
  return view.rpc.localize(
      {static_cast<double>(view.width()) / 2, static_cast<double>(view.height()) / 2},
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
      throw Error(views[0].label() + " and " + view.label() +
                  " do not overlap on the ground, expected images of one place");
    ground.push_back(
        footprint(view.rpc, view.width(), view.height(), zone, height_of(view, range)));
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
      throw ConfigError("height range: " + span_text(*wanted) + ", but " + a.label() + " and " +
                        b.label() + " see no common ground at these heights (they do at " + near +
                        "), expected the heights of the ground");
    }
  const auto centre_a = polygon_centroid(ground_a), centre_b = polygon_centroid(ground_b);
  throw Error(a.label() + " and " + b.label() + " do not overlap on the ground (centres " +
              kilometres(std::hypot(centre_a[0] - centre_b[0], centre_a[1] - centre_b[1])) +
              " apart), expected images of one place");
}

/// throws Error, ConfigError for a pair without common ground or parallax
void check_overlaps(const std::vector<View>& views, const std::vector<Polygon>& ground,
                    const rpc::UtmZone& zone, const rpc::HeightRange& range,
                    const std::optional<rpc::HeightRange>& wanted, Together together) {
  for (std::size_t i = 0; i < views.size(); ++i)
    for (std::size_t j = i + 1; j < views.size(); ++j) {
      const Polygon both = intersect(ground[i], ground[j]);
      if (both.empty() && together == Together::connected && views.size() > 2) continue;
      if (both.empty()) refuse_apart(views[i], views[j], ground[i], ground[j], zone, wanted);
      check_parallax(views[i], views[j], zone, polygon_centroid(both), height_of(views[i], range));
    }
}

}  // namespace

std::string terrain_contradicted(const ViewRules& rules, const UserScene& user) {
  const rpc::HeightRange& said = user.range.height_range;
  if (!user.pointing || user.range.source != kTerrainRange || holds(said, user.pointing->heights))
    return "";
  return rules.terrain->path().string() + ": surface from " + span_text(said) +
         ", the images see it from " + span_text(*user.pointing->heights) + ", expected it within";
}

void check_height_range(const rpc::HeightRange& wanted) {
  constexpr double kLeastSpan = 1;  // m
  if (wanted.span() >= kLeastSpan) return;
  char text[120];
  std::snprintf(text, sizeof text,
                "height range: %.10g %.10g, expected the lower height first and a span of at "
                "least %g m",
                wanted.low, wanted.high, kLeastSpan);
  throw ConfigError(text);
}

void ViewList::add(const rpc::Image& image, const std::string& name, const fs::path& file) {
  Validity left = apply(rules_.validity, image.pixels, image.valid);
  if (std::ranges::none_of(left.valid.values(), [](float v) { return v > 0; }))
    throw IoError((file.empty() ? name : file.string()) +
                  ": no pixel but the nodata that was named, expected an image");
  rpc::Image counted = image;
  counted.valid = std::move(left.valid);
  View view = view_of(counted, file);
  view.border = left.border;
  view.name = view_name(name, views_);
  if (const auto& range = image.info.height_range) named_ = named_ ? hull(*named_, *range) : *range;
  check_image(view);
  views_.push_back(std::move(view));
}

UserScene ViewList::scene(const std::optional<rpc::HeightRange>& wanted,
                          const std::function<void()>& poll) && {
  if (views_.empty()) throw Error("no image, expected two or more");
  if (views_.size() == 1)
    throw Error(views_[0].label() + " is the only image, expected two or more");
  UserScene out;
  Scene& scene = out.scene;
  scene.views = chosen(std::move(views_), wanted ? wanted : named_, rules_.most_views,
                       rules_.together, out.left_out);
  out.range = choose_range(wanted, named_, scene.views);
  const RangeChoice known = out.range;  // without the terrain
  const rpc::Geodetic centre = centre_of(scene.views[0], known.height_range);
  scene.frame.zone = rpc::utm_zone_of(centre.lon, centre.lat);
  if (rules_.terrain && !wanted)
    out.range = choice_by_terrain(*rules_.terrain, known, scene.views, scene.frame.zone);
  const rpc::HeightRange first = out.range.height_range;  // before images have been compared
  const std::vector<Polygon> ground = footprints(scene.views, scene.frame.zone, first);
  check_overlaps(scene.views, ground, scene.frame.zone, first, wanted, rules_.together);
  Polygon common = ground[0];
  for (const Polygon& g : ground) common = intersect(common, g);
  const auto origin = polygon_centroid(common.empty() ? ground[0] : common);
  scene.frame.easting0 = std::round(origin[0]), scene.frame.northing0 = std::round(origin[1]);
  if (!first.has_span())  // after the overlap: images of two places seldom share a range either
    throw Error(scene.views[0].label() +
                " and the others: cameras for different heights, expected a range "
                "they share; give a height range");
  scene.frame.h0 = std::round(first.middle());
  scene.name = scene.views[0].name;
  if (rules_.mask) check_mask(*rules_.mask, ground, scene.frame.zone);

  if (const PointingChoice& pointing = rules_.pointing; pointing.given || pointing.measure) {
    out.pointing = pointing.given ? given_pointing(scene.views, *pointing.given, first, poll)
                                  : measure_pointing(scene.views, first, poll, pointing.affine);
    if (out.pointing->applied) {
      apply_pointing(*out.pointing, scene.views);
      if (out.range.source == kMetadataRange && !holds(first, out.pointing->heights))
        out.range = {camera_range(scene.views), kCameraRange, out.range.trouble};
    }
    if (std::string trouble = terrain_contradicted(rules_, out); !trouble.empty()) {
      out.range = known.source == kMetadataRange && holds(known.height_range, out.pointing->heights)
                      ? known
                      : RangeChoice{camera_range(scene.views), kCameraRange};
      out.range.trouble = std::move(trouble);
    }
  }

  if (out.range.source == kCameraRange) {
    const rpc::HeightRange searched = out.range.height_range;
    const FoundHeights found =
        range_of_all(scene, ground, scene.frame.z_from_heights(searched), poll,
                     rules_.mask ? under_mask(*rules_.mask, scene, searched)
                                 : std::function<bool(double, double)>{});
    const rpc::HeightRange agreed = scene.frame.heights_from_z(found.agreed);
    out.range = {scene.frame.heights_from_z(found.range), "found by comparing the images",
                 out.range.trouble, true};
    scene.frame.h0 = std::round(out.range.height_range.middle());
    scene.z_agreed = scene.frame.z_from_heights(agreed);
  }
  scene.z_range = scene.frame.z_from_heights(out.range.height_range);
  return out;
}

UserScene scene_from_views(const std::vector<fs::path>& files,
                           const std::vector<fs::path>& image_dirs,
                           const std::optional<rpc::HeightRange>& wanted,
                           const std::function<void()>& poll, const ViewRules& rules) {
  if (files.size() == 1)  // before it is read
    throw Error(files[0].string() + " is the only image, expected two or more");
  ViewList views(rules);
  for (const fs::path& file : files) {
    if (poll) poll();
    views.add(rpc::open_view(file, image_dirs), file.stem().string(), file);
  }
  return std::move(views).scene(wanted, poll);
}

}  // namespace satsurf::scene

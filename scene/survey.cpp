// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/survey.h"

#include "satsurf/core/parallel.h"
#include "satsurf/scene/height_range.h"
#include "satsurf/scene/view_geometry.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <string>
#include <utility>

namespace satsurf::scene {
namespace {

namespace fs = std::filesystem;

constexpr Index kCopy = 2048;    // px, longer side of a reduced copy
constexpr Index kWindow = 1536;  // px, side of a window in which tie points are looked for
constexpr std::size_t kWindows = 9;
constexpr double kRim = 4;    // px beyond what a box of ground needs: interpolation, rounding
constexpr Index kLeast = 16;  // px; narrower windows say nothing

/// Whether all channels of a pixel have these values.
bool has_values(const Tensor& pixels, Index i, const std::vector<float>& values) {
  const Index P = pixels.dim(1) * pixels.dim(2);
  for (std::size_t c = 0; c < values.size(); ++c)
    if (pixels[static_cast<Index>(c) * P + i] != values[c]) return false;
  return true;
}

/// Notes the border of a reduced copy.
void note_border(SurveyedView& view, const rpc::Image& image, const std::vector<double>& nodata) {
  const Validity named = apply({.nodata = nodata, .borders = false}, image.pixels, image.valid);
  Tensor border = border_of(image.pixels, named.valid);
  const Index C = image.pixels.dim(0), P = border.count();
  for (Index i = 0; i < P; ++i) {
    if (!(border[i] > 0)) continue;
    const bool known = std::ranges::any_of(
        view.border_values, [&](const auto& v) { return has_values(image.pixels, i, v); });
    if (known) continue;
    auto& values = view.border_values.emplace_back();
    for (Index c = 0; c < C; ++c) values.push_back(image.pixels[c * P + i]);
  }
  if (!view.border_values.empty()) view.border = std::move(border);
}

/// Makes the border's pixels of a window invalid: those with its values, on it or beside it in the
/// reduced copy.
void leave_border_out(const Survey& survey, const SurveyedView& view,
                      const rpc::PixelWindow& window, rpc::Image& image) {
  if (view.border.empty()) return;
  const Index h = view.border.dim(0), w = view.border.dim(1);
  for (Index y = 0; y < window.height; ++y)
    for (Index x = 0; x < window.width; ++x) {
      const Index i = y * window.width + x;
      if (!(image.valid[i] > 0)) continue;
      if (std::ranges::none_of(view.border_values,
                               [&](const auto& v) { return has_values(image.pixels, i, v); }))
        continue;
      const Index v = (window.y0 + y) / survey.factor, u = (window.x0 + x) / survey.factor;
      bool near = false;
      for (Index b = std::max<Index>(0, v - 1); b <= std::min(h - 1, v + 1); ++b)
        for (Index a = std::max<Index>(0, u - 1); a <= std::min(w - 1, u + 1); ++a)
          near = near || view.border[b * w + a] > 0;
      if (near) image.valid[i] = 0;
    }
}

/// A window with what does not count left out.
rpc::Image counted_window(const Survey& survey, const SurveyedView& view,
                          const rpc::PixelWindow& window) {
  rpc::Image image = rpc::open_window(view.source, window);
  image.valid = apply({.nodata = survey.nodata, .borders = false}, image.pixels, image.valid).valid;
  leave_border_out(survey, view, window, image);
  return image;
}

/// A window as a view of the scene.
View view_in(const Survey& survey, std::size_t i, const rpc::PixelWindow& window,
             const rpc::Image& image) {
  const View& whole = survey.user.scene.views[i];
  View view = whole;  // shares the copy's pixels until they are replaced
  view.rgb = rpc::to_rgb(image, whole.colours);
  view.valid = image.valid;
  view.rpc =
      survey.views[i].rpc.cropped(static_cast<double>(window.x0), static_cast<double>(window.y0));
  return view;
}

/// The part of a wanted window that lies in an image; nothing where that is too narrow.
std::optional<rpc::PixelWindow> inside(const SurveyedView& view, double x0, double y0, double x1,
                                       double y1) {
  const auto clipped = [](double v, Index most) {
    return static_cast<Index>(std::clamp(v, 0.0, static_cast<double>(most)));
  };
  const Index left = clipped(std::floor(x0), view.width),
              top = clipped(std::floor(y0), view.height),
              right = clipped(std::ceil(x1) + 1, view.width),
              bottom = clipped(std::ceil(y1) + 1, view.height);
  if (right - left < kLeast || bottom - top < kLeast) return std::nullopt;
  return rpc::PixelWindow{left, top, right - left, bottom - top};
}

/// Ground points spread over what two views or more show.
std::vector<rpc::Geodetic> places_for_ties(const Survey& survey) {
  constexpr int kTried = 7;  // a side
  const Scene& scene = survey.user.scene;
  const double z = scene.z_range.middle();
  Ground all{INFINITY, INFINITY, -INFINITY, -INFINITY};
  for (const View& v : scene.views)
    for (const auto& [x, y] :
         footprint(v.rpc, v.width(), v.height(), scene.frame.zone, z + scene.frame.h0))
      all = {std::min(all.x0, x), std::min(all.y0, y), std::max(all.x1, x), std::max(all.y1, y)};
  std::vector<rpc::Geodetic> shown;
  for (int i = 0; i < kTried; ++i)
    for (int j = 0; j < kTried; ++j) {
      const auto at =
          rpc::geodetic_from_utm(scene.frame.zone, all.x0 + (j + 0.5) / kTried * all.width(),
                                 all.y0 + (i + 0.5) / kTried * all.height());
      const rpc::Geodetic p{at[0], at[1], z + scene.frame.h0};
      if (std::ranges::count_if(scene.views, [&](const View& v) { return v.shows(p); }) >= 2)
        shown.push_back(p);
    }
  if (shown.size() <= kWindows) return shown;
  std::vector<rpc::Geodetic> chosen;
  for (std::size_t k = 0; k < kWindows; ++k)
    chosen.push_back(shown[(2 * k + 1) * shown.size() / (2 * kWindows)]);
  return chosen;
}

/// Tie points of the whole images, found in windows of them.
/// shifts  by which the cameras are known to be off
std::vector<TiePoint> ties_in_windows(const Survey& survey, const std::vector<KnownShift>& shifts,
                                      const std::function<void()>& poll) {
  std::vector<TiePoint> out;
  for (const rpc::Geodetic& place : places_for_ties(survey)) {
    std::vector<View> views;
    std::vector<std::size_t> numbers;
    std::vector<rpc::PixelWindow> windows;
    for (std::size_t i = 0; i < survey.views.size(); ++i) {
      if (poll) poll();
      const SurveyedView& view = survey.views[i];
      const rpc::Pixel p = view.rpc.project(place);
      constexpr double kHalf = static_cast<double>(kWindow) / 2;
      const auto window = inside(view, p.x - kHalf, p.y - kHalf, p.x + kHalf - 1, p.y + kHalf - 1);
      if (!window) continue;
      views.push_back(view_in(survey, i, *window, counted_window(survey, view, *window)));
      views.back().rpc = views.back().rpc.corrected(
          shifts[i].shift, shifts[i].slope.cropped(static_cast<double>(window->x0),
                                                   static_cast<double>(window->y0)));
      numbers.push_back(i), windows.push_back(*window);
    }
    if (views.size() < 2) continue;
    for (TiePoint& tie :
         find_tie_points(views, survey.user.range.height_range, kLargestPointingError, poll)) {
      for (Sighting& s : tie.sightings) {
        const rpc::PixelWindow& window = windows[s.view];
        s = {numbers[s.view],
             {s.pixel.x + static_cast<double>(window.x0),
              s.pixel.y + static_cast<double>(window.y0)}};
      }
      out.push_back(std::move(tie));
    }
  }
  return out;
}

/// The views with their whole cameras and no pixels.
std::vector<View> heads_of(const Survey& survey) {
  std::vector<View> heads;
  for (std::size_t i = 0; i < survey.views.size(); ++i) {
    const View& view = survey.user.scene.views[i];
    View& head = heads.emplace_back();
    head.name = view.name, head.file = view.file, head.rpc = survey.views[i].rpc;
  }
  return heads;
}

/// Shifts the cameras of the copies as the pointing of the whole images says.
void shift_copies(Survey& survey) {
  const double f = static_cast<double>(survey.factor);
  for (std::size_t i = 0; i < survey.views.size(); ++i) {
    const rpc::Pixel& s = survey.user.pointing->shifts[i];
    View& copy = survey.user.scene.views[i];
    copy.rpc =
        copy.rpc.corrected({s.x / f, s.y / f}, survey.user.pointing->slope(i).resized(1 / f));
  }
}

/// Measures the pointing of whole images and shifts the cameras, theirs and those of the copies.
void correct_pointing(Survey& survey, const PointingChoice& choice,
                      const std::function<void()>& poll) {
  if (!choice.given && !choice.measure) return;
  const std::vector<View> heads = heads_of(survey);
  const double height = survey.user.range.height_range.middle();
  const std::vector<KnownShift> known =
      choice.given ? shifts_of(heads, *choice.given) : std::vector<KnownShift>(survey.views.size());
  const std::vector<TiePoint> ties = ties_in_windows(survey, known, poll);
  survey.user.pointing = choice.given ? given_pointing(heads, known, ties, height)
                                      : pointing_from(heads, ties, height, choice.affine);
  if (!survey.user.pointing->applied) return;
  for (std::size_t i = 0; i < survey.views.size(); ++i) {
    const Pointing& pointing = *survey.user.pointing;
    survey.views[i].rpc = survey.views[i].rpc.corrected(pointing.shifts[i], pointing.slope(i));
  }
  shift_copies(survey);
}

/// The copies of all images, the largest read first: where one is damaged and claims a size that
/// leaves nothing of the others, it is the one to name.
std::vector<rpc::Image> reduced_copies(const Survey& survey, const std::function<void()>& poll) {
  std::vector<std::size_t> order(survey.views.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::ranges::stable_sort(order, std::ranges::greater{}, [&](std::size_t i) {
    return survey.views[i].width * survey.views[i].height;
  });
  std::vector<rpc::Image> copies(order.size());
  for (const std::size_t i : order) {
    if (poll) poll();
    copies[i] = rpc::open_reduced(survey.views[i].source, survey.factor);
  }
  return copies;
}

/// Takes away the views that were not chosen. Those that were stand in the same order, in which a file
/// that was named twice may be chosen once.
void keep_chosen(Survey& survey) {
  std::vector<SurveyedView> kept;
  const std::vector<View>& chosen = survey.user.scene.views;
  for (SurveyedView& view : survey.views)
    if (kept.size() < chosen.size() && chosen[kept.size()].file == view.source.file)
      kept.push_back(std::move(view));
  survey.views = std::move(kept);
}

}  // namespace

Survey survey_views(const std::vector<fs::path>& files, const std::vector<fs::path>& image_dirs,
                    const std::optional<rpc::HeightRange>& wanted,
                    const std::function<void()>& poll, const ViewRules& rules) {
  if (files.size() == 1)  // before it is read
    throw Error(files[0].string() + " is the only image, expected two or more");
  Survey out;
  out.nodata = rules.validity.nodata;
  Index largest = 0;
  for (const fs::path& file : files) {
    const rpc::RasterInfo info = rpc::view_info(file, image_dirs);
    out.views.push_back({.source = rpc::find_view(file, image_dirs),
                         .width = info.width,
                         .height = info.height,
                         .rpc = *info.rpc});
    out.colour = out.colour || info.bands >= 3;
    largest = std::max({largest, info.width, info.height});
  }
  out.factor = std::max<Index>(1, (largest + kCopy - 1) / kCopy);
  const bool whole = out.factor == 1;
  out.most_views = rules.most_views;
  ViewRules of_copies = rules;
  of_copies.most_views = std::max(kMostSurveyed, rules.most_views);
  of_copies.together = Together::connected;
  if (!whole) of_copies.pointing = {.measure = false};
  const auto made_of_copies = [&](const ViewRules& by) {
    ViewList list(by);
    std::vector<rpc::Image> copies = reduced_copies(out, poll);
    for (std::size_t i = 0; i < copies.size(); ++i) {
      SurveyedView& view = out.views[i];
      if (rules.validity.borders) note_border(view, copies[i], out.nodata);
      list.add(std::exchange(copies[i], {}), view.source.file.stem().string(), view.source.file);
    }
    return std::move(list).scene(wanted, poll);
  };
  out.user = made_of_copies(of_copies);
  keep_chosen(out);
  if (whole)
    for (std::size_t i = 0; i < out.views.size(); ++i)
      out.views[i].rpc = out.user.scene.views[i].rpc;
  else
    correct_pointing(out, rules.pointing, poll);
  if (std::string trouble = whole ? "" : terrain_contradicted(rules, out.user); !trouble.empty()) {
    // Once more as if there were no such terrain; the choice of views does not depend on it.
    of_copies.terrain = nullptr;
    UserScene again = made_of_copies(of_copies);
    again.pointing = std::move(out.user.pointing);
    again.left_out = std::move(out.user.left_out);  // of these views none is
    again.range.trouble = std::move(trouble);
    out.user = std::move(again);
    if (out.user.pointing->applied) shift_copies(out);
  }
  for (std::size_t i = 0; i < out.views.size(); ++i)
    out.views[i].colours = out.user.scene.views[i].colours;
  return out;
}

std::optional<rpc::PixelWindow> window_of(const SurveyedView& view, const rpc::LocalFrame& frame,
                                          const Polygon& ground, const rpc::HeightRange& z_range) {
  double x0 = INFINITY, y0 = INFINITY, x1 = -INFINITY, y1 = -INFINITY;
  const auto show = [&](double x, double y) {
    for (const double z : {z_range.low, z_range.high}) {
      const rpc::Pixel p = view.rpc.project(frame.geodetic_from_local({x, y, z}));
      x0 = std::min(x0, p.x), y0 = std::min(y0, p.y);
      x1 = std::max(x1, p.x), y1 = std::max(y1, p.y);
    }
  };
  for (std::size_t i = 0; i < ground.size(); ++i) {
    const auto &a = ground[i], &b = ground[(i + 1) % ground.size()];
    show(a[0], a[1]);
    show(0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]));  // sides are not quite straight in an image
  }
  return inside(view, x0 - kRim, y0 - kRim, x1 + kRim, y1 + kRim);
}

std::vector<std::size_t> views_of(const Survey& survey, const Polygon& ground,
                                  const rpc::HeightRange& z_range) {
  constexpr int kTried = 16;  // a side
  const Scene& whole = survey.user.scene;
  std::vector<std::size_t> showing;
  for (std::size_t i = 0; i < survey.views.size(); ++i)
    if (window_of(survey.views[i], whole.frame, ground, z_range)) showing.push_back(i);
  if (showing.size() <= static_cast<std::size_t>(survey.most_views)) return showing;
  const Ground box = bounds_of(ground);
  std::vector<rpc::Geodetic> points;
  for (int k = 0; k < kTried * kTried; ++k) {
    const double x = box.x0 + (k % kTried + 0.5) / kTried * box.width(),
                 y = box.y0 + (k / kTried + 0.5) / kTried * box.height();
    if (contains(ground, x, y))
      points.push_back(whole.frame.geodetic_from_local({x, y, z_range.middle()}));
  }
  std::vector<View> views;
  std::vector<std::vector<char>> shows;
  for (const std::size_t i : showing) {
    views.push_back(whole.views[i]);  // shares the copy's pixels
    auto& seen = shows.emplace_back();
    for (const rpc::Geodetic& p : points)
      seen.push_back(static_cast<char>(whole.views[i].shows(p)));
  }
  std::vector<std::size_t> out;
  for (const Index k :
       choose_for_ground(views, shows, z_range.middle() + whole.frame.h0, survey.most_views))
    out.push_back(showing[static_cast<std::size_t>(k)]);
  return out;
}

WindowedScene read_windows(const Survey& survey, const Polygon& ground,
                           const rpc::HeightRange& z_range) {
  const Scene& whole = survey.user.scene;
  WindowedScene out;
  out.scene.name = whole.name, out.scene.frame = whole.frame, out.scene.z_range = z_range;
  for (const std::size_t i : views_of(survey, ground, z_range)) {
    const SurveyedView& view = survey.views[i];
    const auto window = window_of(view, whole.frame, ground, z_range);
    if (!window) continue;
    const rpc::Image image = counted_window(survey, view, *window);
    if (std::ranges::none_of(image.valid.values(), [](float v) { return v > 0; })) continue;
    out.scene.views.push_back(view_in(survey, i, *window, image));
    out.views.push_back(i);
    const Index P = image.valid.count(), channels = survey.colour ? 3 : 1;
    auto values = Tensor::uninitialised({channels, image.valid.dim(0), image.valid.dim(1)});
    for (Index c = 0; c < channels; ++c)
      std::copy_n(image.pixels.data() + view.colours.channels[static_cast<std::size_t>(c)] * P, P,
                  values.data() + c * P);
    out.values.push_back(std::move(values));
  }
  return out;
}

}  // namespace satsurf::scene

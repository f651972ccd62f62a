// SPDX-License-Identifier: Apache-2.0
#include "satsurf/reconstruct/warnings.h"

#include "satsurf/rpc/fit.h"
#include "satsurf/scene/view_pair.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <optional>

namespace satsurf::reconstruct {
namespace {

// What the weights were trained on is 0.3 to 0.6 m and views up to 32 degrees from the vertical;
// the rest are numbers beyond which one of the simulated or real scenes has gone wrong.
constexpr double kLeastSize = 0.25, kLargestSize = 0.75;  // m
constexpr double kLeastBase = 0.08, kLargestBase = 0.9;   // ground metres per metre of height
constexpr double kSunsApart = 40;                         // degrees
constexpr double kDaysApart = 365;
constexpr double kEndOfRange = 0.02, kPiledUp = 0.05;  // of the range, of the cells
constexpr double kLowConfidence = 0.4;
constexpr double kComplete = 0.8;
constexpr double kWorstFit = 0.1;      // px; more shows in the heights
constexpr double kUnconfirmed = 0.08;  // a cloud of a twelfth; other light and seasons reach 0.07

template <class... Args>
std::string text_of(const char* format, Args... args) {
  std::array<char, 400> text{};
  std::snprintf(text.data(), text.size(), format, args...);
  return text.data();
}

/// A number of a pair of views, and which they are.
struct OfPair {
  double value;
  const scene::View *a, *b;
};
/// The pairs with the smallest and the largest number; nothing where no pair has one.
template <class F>
std::optional<std::pair<OfPair, OfPair>> extremes(const std::vector<scene::View>& views, F&& of) {
  std::optional<std::pair<OfPair, OfPair>> out;
  for (std::size_t i = 0; i < views.size(); ++i)
    for (std::size_t j = i + 1; j < views.size(); ++j) {
      const std::optional<double> v = of(i, j);
      if (!v) continue;
      const OfPair pair{*v, &views[i], &views[j]};
      if (!out) out = {pair, pair};
      if (pair.value < out->first.value) out->first = pair;
      if (pair.value > out->second.value) out->second = pair;
    }
  return out;
}

/// Share of the known cells that lie at the lowest, and at the highest part of the range.
std::array<double, 2> share_at_ends(const Tensor& z, const rpc::HeightRange& range) {
  const double margin = kEndOfRange * range.span();
  double low = 0, high = 0, known = 0;
  for (const float v : z.values()) {
    if (!std::isfinite(v)) continue;
    known += 1;
    low += static_cast<double>(v) < range.low + margin;
    high += static_cast<double>(v) > range.high - margin;
  }
  if (known == 0) return {0, 0};
  return {low / known, high / known};
}

double mean_of(const Tensor& t) {
  double sum = 0, n = 0;
  for (const float v : t.values())
    if (std::isfinite(v)) sum += static_cast<double>(v), n += 1;
  return n > 0 ? sum / n : 0;
}

}  // namespace

std::vector<Warning> scene_warnings(const scene::Scene& scene) {
  std::vector<Warning> out;
  std::vector<rpc::ViewGeometry> geometry;
  double size = 0;
  for (const scene::View& v : scene.views) {
    geometry.push_back(rpc::view_geometry(
        rpc::pixel_jacobian(v.rpc, scene.frame, {0, 0, scene.z_range.middle()})));
    size += geometry.back().footprint / static_cast<double>(scene.views.size());
  }
  if (size < kLeastSize || size > kLargestSize)
    out.push_back({"ground_size", text_of("pixels of %.2f m on the ground, the network was trained "
                                          "on 0.3 to 0.6 m; expect more errors",
                                          size)});
  const auto base = extremes(scene.views, [&](std::size_t i, std::size_t j) {
    const auto &p = geometry[i].direction, &q = geometry[j].direction;
    return std::optional(std::hypot(p[0] - q[0], p[1] - q[1]));
  });
  if (base && base->second.value < kLeastBase)
    out.push_back({"little_parallax",
                   text_of("the views are alike: no two are more than %.3f m of ground apart per "
                           "metre of height, expected %.2f or more; heights are rough",
                           base->second.value, kLeastBase)});
  if (base && base->first.value > kLargestBase)
    out.push_back({"much_parallax",
                   text_of("the views are very unlike: even %s and %s are %.2f m of ground apart "
                           "per metre of height, expected %.1f at most; walls hide much",
                           base->first.a->name.c_str(), base->first.b->name.c_str(),
                           base->first.value, kLargestBase)});
  const auto suns = extremes(scene.views, [&](std::size_t i, std::size_t j) {
    return scene::suns_apart(scene.views[i], scene.views[j]);
  });
  if (suns && suns->second.value > kSunsApart)
    out.push_back({"suns_apart", text_of("the sun of %s and %s is %.0f degrees apart, shadows lie "
                                         "elsewhere; expected %.0f at most",
                                         suns->second.a->name.c_str(), suns->second.b->name.c_str(),
                                         suns->second.value, kSunsApart)});
  const auto days = extremes(scene.views, [&](std::size_t i, std::size_t j) {
    return scene::days_apart(scene.views[i], scene.views[j]);
  });
  if (days && days->second.value > kDaysApart)
    out.push_back(
        {"dates_apart", text_of("%s and %s are %.1f years apart, what was built or grown "
                                "between them is not to be matched",
                                days->second.a->name.c_str(), days->second.b->name.c_str(),
                                days->second.value / 365.25)});
  return out;
}

std::vector<Warning> surface_warnings(const Reconstruction& made) {
  std::vector<Warning> out;
  const rpc::HeightRange range = made.frame.heights_from_z(made.z_range);
  const auto ends = share_at_ends(made.dsm.z, made.z_range);
  for (const std::size_t end : {std::size_t{0}, std::size_t{1}})
    if (ends[end] > kPiledUp)
      out.push_back(
          {"end_of_range",
           text_of("%.0f %% of the surface lie at the %s end of the height range, %.1f m; "
                   "the range may miss the surface",
                   100 * ends[end], end == 0 ? "lower" : "upper",
                   end == 0 ? range.low : range.high)});
  if (const double confidence = mean_of(made.confidence); confidence < kLowConfidence)
    out.push_back({"low_confidence",
                   text_of("confidence %.2f on average, expected %.1f or more; the cameras or the "
                           "height range may be wrong, or the images too different",
                           confidence, kLowConfidence)});
  if (made.completeness < kComplete)
    out.push_back({"large_gaps", text_of("%.0f %% of the common ground has a height, expected %.0f "
                                         "or more; the images may contradict each other",
                                         100 * made.completeness, 100 * kComplete)});
  if (made.camera_fit_max_px > kWorstFit)
    out.push_back({"camera_fit",
                   text_of("cameras were fitted to %.2f px only, expected %.1f; the images may be "
                           "too large or the height range too wide",
                           made.camera_fit_max_px, kWorstFit)});
  return out;
}

std::vector<Warning> image_warnings(const ImageAgreement& agreement,
                                    const std::vector<scene::View>& views) {
  std::vector<Warning> out;
  const std::vector<double>& shares = agreement.unconfirmed;
  for (std::size_t i = 0; i < shares.size(); ++i)
    if (shares[i] > kUnconfirmed)
      out.push_back({"image_differs",
                     text_of("%s: %.0f %% of the ground on which other images agree look different "
                             "in it, expected %.0f or less: clouds, snow, another season or "
                             "light, changes? Heights there rest on the other images",
                             views.at(i).name.c_str(), 100 * shares[i], 100 * kUnconfirmed)});
  return out;
}

std::vector<std::pair<std::string, std::string>> warning_codes() {
  return {
      {"ground_size",
       text_of("pixels below %g or above %g m on the ground", kLeastSize, kLargestSize)},
      {"little_parallax",
       text_of("no two views are %g m of ground apart per metre of height", kLeastBase)},
      {"much_parallax", text_of("every two views are more than %g apart", kLargestBase)},
      {"suns_apart", text_of("suns more than %g degrees apart", kSunsApart)},
      {"dates_apart", text_of("dates more than %g days apart", kDaysApart)},
      {"end_of_range", text_of("more than %g %% of the cells within %g %% of the height range "
                               "from one of its ends",
                               100 * kPiledUp, 100 * kEndOfRange)},
      {"low_confidence", text_of("mean confidence below %g", kLowConfidence)},
      {"large_gaps", text_of("completeness below %g %%", 100 * kComplete)},
      {"image_differs", text_of("more than %g %% of the ground on which other images agree look "
                                "different in an image; needs three images",
                                100 * kUnconfirmed)},
      {"camera_fit", text_of("cameras fitted to worse than %g px", kWorstFit)}};
}

}  // namespace satsurf::reconstruct

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
constexpr double kInTwo = 0.125;       // of the surface; the rims of small triplets reach 0.12
constexpr double kDisagree = 1;        // px; images of different years are left with 0.7
constexpr double kBelowTies = 60;      // m, or the span of the tie points if that is more
constexpr double kLifted = 5;          // m; what vendors promise of their heights

template <class... Args>
std::string text_of(const char* format, Args... args) {
  std::array<char, 400> text{};
  std::snprintf(text.data(), text.size(), format, args...);
  return text.data();
}

/// A number with `digits` behind the point, or as many more as tell it from its limit.
std::string apart_from(double limit, double value, int digits) {
  constexpr int kMost = 6;
  const auto text = [](double v, int n) { return text_of("%.*f", n, v); };
  while (digits < kMost && value != limit && text(value, digits) == text(limit, digits)) ++digits;
  return text(value, digits);
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

/// Where views look from and how large their pixels are, in the middle of the scene.
std::vector<rpc::ViewGeometry> geometry_of(const scene::Scene& scene) {
  std::vector<rpc::ViewGeometry> out;
  for (const scene::View& v : scene.views)
    out.push_back(rpc::view_geometry(
        rpc::pixel_jacobian(v.rpc, scene.frame, {0, 0, scene.z_range.middle()})));
  return out;
}

/// By how much all heights together may be off, m. Lifting the ground by h moves view i against the
/// mean of all by h d_i pixels, which no residual shows. Where shifts are off by chance, sigma px along
/// each axis, the lift that best suits them has a deviation of
///   sigma / sqrt(sum_i |d_i|^2)    with    sigma^2 = sum_i |s_i|^2 / (2 N - 3)
/// taken from the shifts that were found, which are without lift and mean.
double lift_deviation(const scene::Pointing& pointing, const scene::Scene& scene) {
  const std::vector<rpc::ViewGeometry> geometry = geometry_of(scene);
  const double n = static_cast<double>(geometry.size());
  std::array<double, 2> mean{};
  for (const rpc::ViewGeometry& g : geometry)
    for (const std::size_t k : {0, 1}) mean[k] += g.direction[k] / n;
  double moved = 0, shifts = 0;
  for (std::size_t i = 0; i < geometry.size(); ++i) {
    const auto& [x, y] = pointing.shifts[i];
    shifts += x * x + y * y;
    for (const std::size_t k : {0, 1})
      moved += std::pow((geometry[i].direction[k] - mean[k]) / geometry[i].footprint, 2);
  }
  return std::sqrt(shifts / (2 * n - 3) / moved);
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
  const std::vector<rpc::ViewGeometry> geometry = geometry_of(scene);
  double size = 0;
  for (const rpc::ViewGeometry& g : geometry)
    size += g.footprint / static_cast<double>(geometry.size());
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
                   text_of("the views are alike: no two are more than %s m of ground apart per "
                           "metre of height, expected %g or more; heights are rough",
                           apart_from(kLeastBase, base->second.value, 3).c_str(), kLeastBase)});
  if (base && base->first.value > kLargestBase)
    out.push_back({"much_parallax",
                   text_of("the views are very unlike: even %s and %s are %s m of ground apart "
                           "per metre of height, expected %g at most; walls hide much",
                           base->first.a->name.c_str(), base->first.b->name.c_str(),
                           apart_from(kLargestBase, base->first.value, 2).c_str(), kLargestBase)});
  const auto suns = extremes(scene.views, [&](std::size_t i, std::size_t j) {
    return scene::suns_apart(scene.views[i], scene.views[j]);
  });
  if (suns && suns->second.value > kSunsApart)
    out.push_back(
        {"suns_apart", text_of("the sun of %s and %s is %s degrees apart, shadows lie "
                               "elsewhere; expected %g at most",
                               suns->second.a->name.c_str(), suns->second.b->name.c_str(),
                               apart_from(kSunsApart, suns->second.value, 0).c_str(), kSunsApart)});
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

std::vector<Warning> pointing_warnings(const scene::Pointing& pointing, const scene::Scene& scene) {
  std::vector<Warning> out;
  if (pointing.after.empty()) {
    out.push_back({"pointing_unknown", "pointing " + pointing.verdict +
                                           "; the cameras stay as they are, and may disagree"});
    return out;
  }
  for (const std::size_t i : pointing.unconnected)
    out.push_back(
        {"pointing_unknown",
         text_of("%s shares too few tie points with the other images: its camera stays as "
                 "it is, and may disagree with theirs",
                 pointing.names[i].c_str())});
  if (pointing.undetermined > 0)
    out.push_back(
        {"pointing_in_part",
         text_of("tie points determine %td of the %td combinations of the shifts that they "
                 "ought to; the cameras may disagree otherwise",
                 pointing.observable, pointing.observable + pointing.undetermined)});
  const auto& left = pointing.applied ? pointing.after : pointing.before;
  for (const scene::PairResidual& pair : left)
    if (pair.ties >= scene::kFewestTies && pair.across > kDisagree)
      out.push_back({"pointing_residual",
                     text_of("%s and %s still disagree by %s px across the epipolar direction, "
                             "expected %g at most; are these the shifts of these images?",
                             pointing.names[pair.a].c_str(), pointing.names[pair.b].c_str(),
                             apart_from(kDisagree, pair.across, 2).c_str(), kDisagree)});
  if (const double lift = lift_deviation(pointing, scene); pointing.applied && lift > kLifted)
    out.push_back(
        {"heights_as_a_whole",
         text_of("cameras that were off by %.1f px may put all heights together %.0f m too high or "
                 "too low and tilt the ground, which images do not show; points measured on it "
                 "would",
                 pointing.largest_shift, lift)});
  return out;
}

std::vector<Warning> range_warnings(const scene::UserScene& user) {
  if (!user.range.found || !user.pointing || !user.pointing->heights) return {};
  const rpc::HeightRange &ties = *user.pointing->heights, &range = user.range.height_range;
  if (ties.low - range.low <= std::max(kBelowTies, ties.span())) return {};
  return {
      {"wide_range",
       text_of("the height range found begins at %.0f m, nine tenths of the tie points lie from "
               "%.0f to %.0f m; one of the images may show something else than the others: give "
               "--height-range, or leave it out",
               range.low, ties.low, ties.high)}};
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
                   text_of("confidence %s on average, expected %g or more; the cameras or the "
                           "height range may be wrong, or the images too different",
                           apart_from(kLowConfidence, confidence, 2).c_str(), kLowConfidence)});
  if (made.completeness < kComplete)
    out.push_back(
        {"large_gaps", text_of("%s %% of the common ground has a height, expected %g "
                               "or more; the images may contradict each other",
                               apart_from(100 * kComplete, 100 * made.completeness, 0).c_str(),
                               100 * kComplete)});
  if (made.camera_fit_max_px > kWorstFit)
    out.push_back({"camera_fit",
                   text_of("cameras were fitted to %s px only, expected %g; the images may be "
                           "too large or the height range too wide",
                           apart_from(kWorstFit, made.camera_fit_max_px, 2).c_str(), kWorstFit)});
  return out;
}

std::vector<Warning> image_warnings(const ImageAgreement& agreement,
                                    const std::vector<scene::View>& views) {
  std::vector<Warning> out;
  const std::vector<double>& shares = agreement.unconfirmed;
  for (std::size_t i = 0; i < shares.size(); ++i)
    if (shares[i] > kUnconfirmed)
      out.push_back({"image_differs",
                     text_of("%s: %s %% of the ground on which other images agree look different "
                             "in it, expected %g or less: clouds, snow, another season or "
                             "light, changes? Heights there rest on the other images",
                             views.at(i).name.c_str(),
                             apart_from(100 * kUnconfirmed, 100 * shares[i], 0).c_str(),
                             100 * kUnconfirmed)});
  if (agreement.in_two > kInTwo)
    out.push_back(
        {"few_images",
         text_of("%s %% of the surface lies in only two of the %zu images, expected %g or "
                 "less; expect more errors there",
                 apart_from(100 * kInTwo, 100 * agreement.in_two, 0).c_str(), views.size(),
                 100 * kInTwo)});
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
      {"pointing_unknown",
       "tie points connect an image too little with the others, or none at all"},
      {"pointing_in_part", "of N images fewer than 2 N - 3 combinations of shifts are determined"},
      {"pointing_residual", text_of("two images disagree by more than %g px across the epipolar "
                                    "direction with the cameras that were used",
                                    kDisagree)},
      {"heights_as_a_whole",
       text_of("shifts so large that all heights together may be more than %g "
               "m off, one standard deviation",
               kLifted)},
      {"wide_range", text_of("a height range found by comparing images that begins more than %g m "
                             "below the tie points, and more than these span",
                             kBelowTies)},
      {"end_of_range", text_of("more than %g %% of the cells within %g %% of the height range "
                               "from one of its ends",
                               100 * kPiledUp, 100 * kEndOfRange)},
      {"low_confidence", text_of("mean confidence below %g", kLowConfidence)},
      {"large_gaps", text_of("completeness below %g %%", 100 * kComplete)},
      {"image_differs", text_of("more than %g %% of the ground on which other images agree look "
                                "different in an image; needs three images",
                                100 * kUnconfirmed)},
      {"few_images", text_of("more than %g %% of the surface in fewer than three of three images "
                             "or more",
                             100 * kInTwo)},
      {"camera_fit", text_of("cameras fitted to worse than %g px", kWorstFit)}};
}

}  // namespace satsurf::reconstruct

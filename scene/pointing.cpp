// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/pointing.h"

#include "satsurf/core/error.h"
#include "satsurf/core/hash.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <numeric>
#include <utility>

namespace satsurf::scene {
namespace {

constexpr double kWorth = 0.3;  // px; smaller shifts change no surface that anybody could tell

std::vector<rpc::Rpc> cameras_of(const std::vector<View>& views) {
  std::vector<rpc::Rpc> out;
  for (const View& v : views) out.push_back(v.rpc);
  return out;
}

std::string number(const char* format, double value) {
  char text[64];
  std::snprintf(text, sizeof text, format, value);
  return text;
}

/// Group of each image when pairs with enough points are one group.
std::vector<std::size_t> groups_of(std::size_t images, const std::vector<PairResidual>& pairs) {
  std::vector<std::size_t> group(images);
  std::iota(group.begin(), group.end(), std::size_t{0});
  for (const PairResidual& pair : pairs) {
    if (pair.ties < kFewestTies) continue;
    const std::size_t from = std::max(group[pair.a], group[pair.b]),
                      to = std::min(group[pair.a], group[pair.b]);
    std::replace(group.begin(), group.end(), from, to);
  }
  return group;
}

/// The largest group, the first of several, by ascending view.
std::vector<std::size_t> largest_group(const std::vector<std::size_t>& group) {
  std::size_t best = 0;
  const auto size = [&](std::size_t g) { return std::ranges::count(group, g); };
  for (const std::size_t g : group)
    if (size(g) > size(best) || (size(g) == size(best) && g < best)) best = g;
  std::vector<std::size_t> members;
  for (std::size_t i = 0; i < group.size(); ++i)
    if (group[i] == best) members.push_back(i);
  return members;
}

/// Says that an image shares too little with the others.
std::string shares_little(const View& view, std::size_t i, const std::vector<PairResidual>& pairs) {
  Index most = 0;
  for (const PairResidual& pair : pairs)
    if (pair.a == i || pair.b == i) most = std::max(most, pair.ties);
  return view.label() + " shares " + std::to_string(most) +
         " tie points with another image, expected " + std::to_string(kFewestTies) + " or more";
}

/// The points that two or more of some views see, numbered anew.
std::vector<TiePoint> among(const std::vector<TiePoint>& points,
                            const std::vector<std::size_t>& members) {
  std::vector<TiePoint> out;
  for (const TiePoint& point : points) {
    TiePoint kept;
    for (const Sighting& s : point.sightings)
      if (const auto at = std::ranges::lower_bound(members, s.view);
          at != members.end() && *at == s.view)
        kept.sightings.push_back({static_cast<std::size_t>(at - members.begin()), s.pixel});
    if (kept.sightings.size() >= 2) out.push_back(std::move(kept));
  }
  return out;
}

/// The middle nine tenths of the points' heights.
std::optional<rpc::HeightRange> middle_of(std::vector<double> heights) {
  if (heights.empty()) return std::nullopt;
  std::sort(heights.begin(), heights.end());
  const auto at = [&](double share) {
    return heights[static_cast<std::size_t>(share * static_cast<double>(heights.size() - 1))];
  };
  return rpc::HeightRange{at(0.05), at(0.95)};
}

/// Notes how long the longest shift is.
void note_largest(Pointing& out, const std::vector<TiePoint>& points) {
  out.largest_shift = 0;
  const auto note = [&](const rpc::Pixel& s) {
    out.largest_shift = std::max(out.largest_shift, std::hypot(s.x, s.y));
  };
  if (out.slopes.empty())
    for (const rpc::Pixel& s : out.shifts) note(s);
  else
    for (const TiePoint& point : points)
      for (const Sighting& s : point.sightings) {
        const rpc::Pixel more = out.slopes[s.view].in(s.pixel);
        note({out.shifts[s.view].x + more.x, out.shifts[s.view].y + more.y});
      }
}

/// Notes how the cameras agree with the shifts in `out`.
void note_after(Pointing& out, const std::vector<rpc::Rpc>& cameras,
                const std::vector<TiePoint>& points, double height) {
  std::vector<rpc::Rpc> corrected = cameras;
  for (std::size_t i = 0; i < cameras.size() && !out.slopes.empty(); ++i)
    corrected[i] = cameras[i].corrected(out.shifts[i], out.slopes[i]);
  TieResiduals after =
      out.slopes.empty()
          ? tie_residuals(cameras, out.shifts, points, height)
          : tie_residuals(corrected, std::vector<rpc::Pixel>(cameras.size()), points, height);
  note_largest(out, points);
  out.after = std::move(after.pairs);
  out.heights = middle_of(std::move(after.heights));
}

/// What is known without a shift.
Pointing agreement(const std::vector<View>& views, const std::vector<TiePoint>& points,
                   double height) {
  Pointing out;
  for (const View& v : views) out.names.push_back(v.name), out.marks.push_back(camera_mark(v.rpc));
  out.shifts.resize(views.size());
  TieResiduals before = tie_residuals(cameras_of(views), out.shifts, points, height);
  out.before = std::move(before.pairs);
  out.heights = middle_of(std::move(before.heights));
  return out;
}

}  // namespace

void apply_pointing(const Pointing& pointing, std::vector<View>& views) {
  for (std::size_t i = 0; i < views.size(); ++i)
    views[i].rpc = views[i].rpc.corrected(pointing.shifts[i], pointing.slope(i));
}

std::optional<double> mean_across(const std::vector<PairResidual>& pairs) {
  double sum = 0, ties = 0;
  for (const PairResidual& pair : pairs) {
    sum += static_cast<double>(pair.ties) * pair.across;
    ties += static_cast<double>(pair.ties);
  }
  if (ties == 0) return std::nullopt;
  return sum / ties;
}

std::string camera_mark(const rpc::Rpc& c) {
  std::string bytes;
  const auto add = [&](double value) {
    // Zero has two signs and one meaning.
    std::uint64_t bits = std::bit_cast<std::uint64_t>(value == 0 ? 0.0 : value);
    for (int byte = 0; byte < 8; ++byte, bits >>= 8) bytes += static_cast<char>(bits & 0xff);
  };
  for (const double v : {c.line_off, c.samp_off, c.lat_off, c.lon_off, c.height_off, c.line_scale,
                         c.samp_scale, c.lat_scale, c.lon_scale, c.height_scale})
    add(v);
  for (const auto* row : {&c.line_num, &c.line_den, &c.samp_num, &c.samp_den})
    for (const double v : *row) add(v);
  char text[17];
  std::snprintf(text, sizeof text, "%016llx", static_cast<unsigned long long>(fnv1a(bytes)));
  return text;
}

Pointing measure_pointing(const std::vector<View>& views, const rpc::HeightRange& height_range,
                          const std::function<void()>& poll, bool affine) {
  return pointing_from(views, find_tie_points(views, height_range, kLargestPointingError, poll),
                       height_range.middle(), affine);
}

Pointing pointing_from(const std::vector<View>& views, const std::vector<TiePoint>& points,
                       double height, bool affine) {
  Pointing out = agreement(views, points, height);
  const std::vector<std::size_t> members = largest_group(groups_of(views.size(), out.before));
  for (std::size_t i = 0; i < views.size(); ++i)
    if (members.size() < 2 || !std::ranges::binary_search(members, i)) out.unconnected.push_back(i);
  if (members.size() < 2) {
    out.verdict = "not estimated: " + shares_little(views[1], 1, out.before);
    return out;
  }
  const std::vector<rpc::Rpc> cameras = cameras_of(views);
  std::vector<rpc::Rpc> connected;
  for (const std::size_t i : members) connected.push_back(cameras[i]);
  const PointingAdjustment found =
      adjust_pointing(connected, among(points, members), height, affine);
  if (affine) out.slopes.resize(views.size());
  for (std::size_t k = 0; k < members.size(); ++k) {
    out.shifts[members[k]] = found.shifts[k];
    if (affine) out.slopes[members[k]] = found.slopes[k];
  }
  out.observable = found.observable;
  if (!affine) out.undetermined = 2 * static_cast<Index>(members.size()) - 3 - found.observable;
  note_after(out, cameras, points, height);
  const double before = *mean_across(out.before), after = *mean_across(out.after),
               largest = out.largest_shift;
  if (largest <= kWorth)
    out.verdict = "not needed: the largest shift is " + number("%.2f px", largest) +
                  number(", no more than %g px", kWorth);
  else if (after >= before)
    out.verdict = "of no use: with shifts the images agree to " + number("%.2f px", after) +
                  number(", without to %.2f px", before);
  else
    out.applied = true, out.verdict = "estimated from the images";
  for (const std::size_t i : out.unconnected)
    out.verdict += "; " + shares_little(views[i], i, out.before) + ": its camera stays as it is";
  return out;
}

std::vector<KnownShift> shifts_of(const std::vector<View>& views, const NamedShifts& shifts) {
  std::vector<KnownShift> chosen;
  for (const View& v : views) {
    const std::string mark = camera_mark(v.rpc);
    auto at = std::ranges::find_if(shifts, [&](const auto& s) { return s.second.mark == mark; });
    if (at == shifts.end()) at = shifts.find(v.name);
    if (at == shifts.end()) {
      std::string names;
      for (const auto& [name, shift] : shifts) names += (names.empty() ? "" : ", ") + name;
      throw ConfigError("pointing: no shift for " + v.name + ", expected one for every image (" +
                        (names.empty() ? "none" : names) + " given)");
    }
    try {
      v.rpc.corrected(at->second.shift, at->second.slope);
    } catch (const Error& e) {
      throw ConfigError("pointing: the slopes of " + v.name + " suit no camera: " + e.what());
    }
    chosen.push_back(at->second);
  }
  return chosen;
}

Pointing given_pointing(const std::vector<View>& views, const NamedShifts& shifts,
                        const rpc::HeightRange& height_range, const std::function<void()>& poll) {
  const std::vector<KnownShift> chosen = shifts_of(views, shifts);
  // Points are looked for where the shifted cameras see them, which is as far as they are off.
  std::vector<View> shifted = views;
  for (std::size_t i = 0; i < views.size(); ++i)
    shifted[i].rpc = views[i].rpc.corrected(chosen[i].shift, chosen[i].slope);
  return given_pointing(views, chosen,
                        find_tie_points(shifted, height_range, kLargestPointingError, poll),
                        height_range.middle());
}

Pointing given_pointing(const std::vector<View>& views, const std::vector<KnownShift>& shifts,
                        const std::vector<TiePoint>& points, double height) {
  Pointing out = agreement(views, points, height);
  const bool sloped =
      std::ranges::any_of(shifts, [](const KnownShift& s) { return !s.slope.empty(); });
  for (std::size_t i = 0; i < shifts.size(); ++i) {
    out.shifts[i] = shifts[i].shift;
    if (sloped) out.slopes.push_back(shifts[i].slope);
  }
  note_after(out, cameras_of(views), points, height);
  out.applied = true;
  out.verdict = "as given";
  return out;
}

}  // namespace satsurf::scene

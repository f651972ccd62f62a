// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/tie_points.h"

#include "satsurf/core/parallel.h"
#include "satsurf/core/whole.h"
#include "satsurf/ops/window_correlation.h"
#include "satsurf/rpc/fit.h"
#include "satsurf/scene/grey_pyramid.h"
#include "satsurf/scene/view_geometry.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <utility>

namespace satsurf::scene {
namespace {

constexpr double kCoarse = 128;     // px, about the side of the images at the coarsest level
constexpr Index kCorners = 32;      // cells along the longer side of an image, a corner in each
constexpr Index kCoarseRadius = 4;  // px, half a window at the coarsest level
constexpr Index kRadius = 7;        // and at the others
constexpr Index kReach = 2;         // px by which a match may move from level to level
constexpr float kCoarseAgreement = 0.5f, kAgreement = 0.6f;  // correlation of a match
constexpr double kReturn = 0.7;                              // px, from where a match leads back to
constexpr double kMode = 1.0;    // px, half the width in which most matches of a pair lie
constexpr double kSpread = 1.5;  // px from there that a match is still believed
// Share of a pair's matches that has to lie there. What chance finds in images of other places are up
// to 40 matches, of which at most 12 and four in ten do, or seven in ten of less than ten.
constexpr double kMajority = 0.7, kMajorityOfMany = 0.5;
constexpr std::ptrdiff_t kMany = 20;  // matches that lie there
constexpr float kContrast = 2e-3f;    // standard deviation of a window that is not flat

using Vec = std::array<double, 2>;
using Matrix = std::array<Vec, 2>;

Vec times(const Matrix& m, const Vec& v) {
  return {m[0][0] * v[0] + m[0][1] * v[1], m[1][0] * v[0] + m[1][1] * v[1]};
}
Matrix inverse(const Matrix& m) {
  const double det = m[0][0] * m[1][1] - m[0][1] * m[1][0];
  return {Vec{m[1][1] / det, -m[0][1] / det}, Vec{-m[1][0] / det, m[0][0] / det}};
}

/// A window brought to zero mean and unit length.
struct Template {
  Index radius = 0;
  std::vector<float> values{};
};

/// The window of `image` about `centre` on a grid whose steps are the columns of `steps`; nothing
/// where it is flat or leaves the image.
std::optional<Template> template_at(const Grey& image, const Vec& centre, const Matrix& steps,
                                    Index radius) {
  Template out{.radius = radius};
  out.values.reserve(static_cast<std::size_t>((2 * radius + 1) * (2 * radius + 1)));
  float sum = 0, squares = 0;
  for (Index v = -radius; v <= radius; ++v)
    for (Index u = -radius; u <= radius; ++u) {
      const Vec off = times(steps, {static_cast<double>(u), static_cast<double>(v)});
      out.values.push_back(image.at(centre[0] + off[0], centre[1] + off[1]));
      sum += out.values.back();
    }
  const auto n = static_cast<float>(out.values.size());
  for (float& value : out.values) {
    value -= sum / n;
    squares += value * value;
  }
  if (!(squares > n * kContrast * kContrast)) return std::nullopt;
  const float length = std::sqrt(squares);
  for (float& value : out.values) value /= length;
  return out;
}

/// Products of a template with `count` windows of an image side by side, the first centred at (x,
/// y); all of them lie inside.
void multiply_row(const Template& t, const Grey& image, Index x, Index y, Index count, float* out) {
  window_products(t.values.data(), 2 * t.radius + 1, image.row(y - t.radius) + (x - t.radius),
                  image.width, count, out);
}

/// One over the length of the window about each of `count` pixels of a row, less its mean; 0 where
/// the window is flat. The same pixels as in `multiply_row`.
void scale_row(const Grey& image, Index radius, Index x, Index y, Index count, float* out) {
  const Index side = 2 * radius + 1, n = count + side - 1;
  const auto area = static_cast<float>(side * side);
  std::vector<float> sum(static_cast<std::size_t>(n)), squares(static_cast<std::size_t>(n));
  for (Index v = 0; v < side; ++v) {
    const float* row = image.row(y - radius + v) + (x - radius);
    for (Index k = 0; k < n; ++k) {
      const auto i = static_cast<std::size_t>(k);
      sum[i] += row[k], squares[i] += row[k] * row[k];
    }
  }
  for (Index k = 0; k < count; ++k) {
    float a = 0, b = 0;
    for (Index u = k; u < k + side; ++u)
      a += sum[static_cast<std::size_t>(u)], b += squares[static_cast<std::size_t>(u)];
    const float spread = b - a * a / area;
    out[k] = spread > area * kContrast * kContrast ? 1 / std::sqrt(spread) : 0.f;
  }
}

/// Correlations of products; -1 where a window is flat or partly unknown, whose product is NaN.
void bring_to_unit(float* products, const float* scale, Index count) {
  for (Index k = 0; k < count; ++k) products[k] = scale[k] > 0 ? products[k] * scale[k] : -1.f;
}

/// Where a template fits best.
struct Fit {
  Vec at{};
  float agreement = -1;
};

/// The best whole pixel within `reach` of `near`, refined by a parabola along each axis; nothing
/// where the search leaves the image or the best lies at its rim.
std::optional<Fit> search(const Template& t, const Grey& image, const Vec& near, Index reach) {
  const Index x0 = floored(std::round(near[0])) - reach, y0 = floored(std::round(near[1])) - reach,
              side = 2 * reach + 1, r = t.radius;
  if (x0 - r < 0 || y0 - r < 0 || x0 + side + r > image.width || y0 + side + r > image.height)
    return std::nullopt;
  std::vector<float> score(static_cast<std::size_t>(side * side));
  std::vector<float> scale(static_cast<std::size_t>(side));
  for (Index v = 0; v < side; ++v) {
    float* row = &score[static_cast<std::size_t>(v * side)];
    multiply_row(t, image, x0, y0 + v, side, row);
    scale_row(image, r, x0, y0 + v, side, scale.data());
    bring_to_unit(row, scale.data(), side);
  }
  const Index best = std::max_element(score.begin(), score.end()) - score.begin();
  const Index u = best % side, v = best / side;
  if (u == 0 || v == 0 || u == side - 1 || v == side - 1) return std::nullopt;
  const auto at = [&](Index dx, Index dy) {
    return static_cast<double>(score[static_cast<std::size_t>((v + dy) * side + u + dx)]);
  };
  const auto peak = [&](double before, double after) {
    const double bend = before - 2 * at(0, 0) + after;
    return bend < 0 ? std::clamp(0.5 * (before - after) / bend, -0.5, 0.5) : 0;
  };
  return Fit{{static_cast<double>(x0 + u) + peak(at(-1, 0), at(1, 0)),
              static_cast<double>(y0 + v) + peak(at(0, -1), at(0, 1))},
             score[static_cast<std::size_t>(best)]};
}

/// A pixel of the image in that of level l.
Vec to_level(const Vec& p, Index level) {
  const double s = std::ldexp(1.0, static_cast<int>(-level));
  return {(p[0] + 0.5) * s - 0.5, (p[1] + 0.5) * s - 0.5};
}
Vec from_level(const Vec& p, Index level) { return to_level(p, -level); }

/// An image turned so that rows run along the epipolar direction.
struct Turned {
  Vec along{}, across{};  ///< unit vectors in the image
  Grey grey;
  Grey scale;  ///< of `scale_row` for the windows of the coarsest level
  double first_along = 0, first_across = 0;  ///< of its pixel (0, 0)

  Turned(const Grey& image, const Vec& direction)
      : along(direction), across{-direction[1], direction[0]} {
    double low[2] = {1e300, 1e300}, high[2] = {-1e300, -1e300};
    for (const double x : {0.0, static_cast<double>(image.width - 1)})
      for (const double y : {0.0, static_cast<double>(image.height - 1)}) {
        const Vec p = of({x, y});
        for (std::size_t k = 0; k < 2; ++k)
          low[k] = std::min(low[k], p[k]), high[k] = std::max(high[k], p[k]);
      }
    first_along = std::floor(low[0]), first_across = std::floor(low[1]);
    grey.width = static_cast<Index>(high[0] - first_along) + 2;
    grey.height = static_cast<Index>(high[1] - first_across) + 2;
    grey.values.resize(static_cast<std::size_t>(grey.width * grey.height));
    for_range(grey.height, 16, [&](Index begin, Index end) {
      for (Index v = begin; v < end; ++v)
        for (Index u = 0; u < grey.width; ++u) {
          const Vec p = back({static_cast<double>(u), static_cast<double>(v)});
          grey.row(v)[u] = image.at(p[0], p[1]);
        }
    });
    constexpr Index r = kCoarseRadius;
    scale = {.height = grey.height, .width = grey.width};
    scale.values.resize(grey.values.size());
    for_range(std::max<Index>(0, grey.height - 2 * r), 16, [&](Index begin, Index end) {
      if (grey.width <= 2 * r) return;
      for (Index v = begin + r; v < end + r; ++v)
        scale_row(grey, r, r, v, grey.width - 2 * r, scale.row(v) + r);
    });
  }
  /// Position along and across of a pixel, not yet counted from the first of `grey`.
  Vec of(const Vec& p) const {
    return {p[0] * along[0] + p[1] * along[1] - first_along,
            p[0] * across[0] + p[1] * across[1] - first_across};
  }
  Vec back(const Vec& q) const {
    const double a = q[0] + first_along, b = q[1] + first_across;
    return {a * along[0] + b * across[0], a * along[1] + b * across[1]};
  }
};

/// Two images and how a pixel moves from the first to the second.
class Pair {
 public:
  Pair(const std::vector<Grey>& a, const std::vector<Grey>& b, const Quadratic& b_from_a,
       const rpc::HeightRange& heights, double largest_px)
      : a_(a), b_(b), map_(b_from_a), heights_(heights), reach_(2 * largest_px) {}

  /// The matches of points of the first image; nothing for those that have none.
  std::vector<std::optional<Vec>> match(const std::vector<Vec>& points) const {
    std::vector<std::optional<Vec>> found = coarse(points);
    for_range(static_cast<Index>(points.size()), 8, [&](Index begin, Index end) {
      for (Index k = begin; k < end; ++k) {
        const auto i = static_cast<std::size_t>(k);
        if (found[i]) found[i] = refine(points[i], *found[i]);
      }
    });
    keep_the_mode(points, found);
    return found;
  }

 private:
  Index top() const { return static_cast<Index>(a_.size()) - 1; }
  /// Derivative of the second pixel by the first, which is the same at every level.
  Matrix plane(const Vec& p) const {
    const auto j = map_.jacobian(p[0], p[1], heights_.middle());
    return {Vec{j[0][0], j[0][1]}, Vec{j[1][0], j[1][1]}};
  }
  Vec seen(const Vec& p, double h) const { return map_(p[0], p[1], h); }

  /// Tries every height and every shift across the epipolar direction at the coarsest level, and
  /// keeps the matches at the shift that suits most corners. In pixels of the whole image.
  std::vector<std::optional<Vec>> coarse(const std::vector<Vec>& points) const {
    const Grey &from = a_.back(), &to = b_.back();
    const double side = std::ldexp(1.0, static_cast<int>(top()));
    const Vec middle{static_cast<double>(a_[0].width) / 2, static_cast<double>(a_[0].height) / 2};
    const Vec low = seen(middle, heights_.low), high = seen(middle, heights_.high);
    const double run = std::hypot(high[0] - low[0], high[1] - low[1]);
    const Turned turned(to, run > 1 && std::isfinite(run)
                                ? Vec{(high[0] - low[0]) / run, (high[1] - low[1]) / run}
                                : Vec{1, 0});
    const auto reach = static_cast<Index>(std::ceil(reach_ / side)) + 1;
    const Index shifts = 2 * reach + 1, r = kCoarseRadius;

    std::vector<Fit> best(points.size() * static_cast<std::size_t>(shifts));
    for_each_index(static_cast<Index>(points.size()), [&](Index k) {
      const Vec& p = points[static_cast<std::size_t>(k)];
      const Matrix back = inverse(plane(p));
      const auto on_turned = [&](double h) { return turned.of(to_level(seen(p, h), top())); };
      const Vec at = on_turned(heights_.middle()),
                ends[2] = {on_turned(heights_.low), on_turned(heights_.high)};
      // The template sits where a whole row of the turned image passes, beside the corner.
      const double off = std::round(at[1]) - at[1];
      const Vec moved = times(back, {off * turned.across[0], off * turned.across[1]});
      const Vec centre = to_level(p, top());
      const Vec along = times(back, turned.along), across = times(back, turned.across);
      const auto t = template_at(from, {centre[0] + moved[0], centre[1] + moved[1]},
                                 {Vec{along[0], across[0]}, Vec{along[1], across[1]}}, r);
      if (!t) return;
      const auto slack = static_cast<double>(reach);
      const Index first = std::max<Index>(r, floored(std::min(ends[0][0], ends[1][0]) - slack)),
                  last = std::min<Index>(turned.grey.width - 1 - r,
                                         -floored(-(std::max(ends[0][0], ends[1][0]) + slack)));
      if (last < first) return;
      std::vector<float> score(static_cast<std::size_t>(last - first + 1));
      for (Index s = 0; s < shifts; ++s) {
        const Index row = floored(std::round(at[1])) + s - reach;
        if (row < r || row >= turned.grey.height - r) continue;
        multiply_row(*t, turned.grey, first, row, last - first + 1, score.data());
        const float* scale = turned.scale.row(row) + first;
        bring_to_unit(score.data(), scale, last - first + 1);
        const auto top_score = std::max_element(score.begin(), score.end());
        best[static_cast<std::size_t>(k * shifts + s)] = {
            turned.back({static_cast<double>(first + (top_score - score.begin())),
                         static_cast<double>(row) - off}),
            *top_score};
      }
    });

    Index common = 0;
    double most = 0;
    for (Index s = 0; s < shifts; ++s) {
      double sum = 0;
      for (std::size_t k = 0; k < points.size(); ++k) {
        const double c = static_cast<double>(
            best[k * static_cast<std::size_t>(shifts) + static_cast<std::size_t>(s)].agreement);
        if (c > 0) sum += c * c * c;  // a good match says more than several poor ones
      }
      if (sum > most) most = sum, common = s;
    }
    std::vector<std::optional<Vec>> found(points.size());
    for (std::size_t k = 0; k < points.size(); ++k) {
      Fit chosen;
      for (Index s = std::max<Index>(0, common - 1); s <= std::min(shifts - 1, common + 1); ++s) {
        const Fit& fit = best[k * static_cast<std::size_t>(shifts) + static_cast<std::size_t>(s)];
        if (fit.agreement > chosen.agreement) chosen = fit;
      }
      if (chosen.agreement >= kCoarseAgreement) found[k] = from_level(chosen.at, top());
    }
    return found;
  }

  /// Follows a match down the levels, and from the last one back.
  std::optional<Vec> refine(const Vec& p, Vec q) const {
    const Matrix forth = plane(p), back = inverse(forth);
    float agreement = 0;
    for (Index level = top(); level >= 0; --level) {
      const auto l = static_cast<std::size_t>(level);
      const auto t = template_at(a_[l], to_level(p, level), back, kRadius);
      if (!t) {
        if (level == 0) return std::nullopt;
        continue;  // a window that leaves the image while it is coarse
      }
      const auto fit = search(*t, b_[l], to_level(q, level), kReach + (level > 0 ? 1 : 0));
      if (!fit) {
        if (level < top()) return std::nullopt;
        continue;
      }
      q = from_level(fit->at, level);
      agreement = fit->agreement;
    }
    if (agreement < kAgreement) return std::nullopt;
    const auto t = template_at(b_[0], q, forth, kRadius);
    if (!t) return std::nullopt;
    const auto fit = search(*t, a_[0], p, kReach);
    if (!fit || fit->agreement < kAgreement) return std::nullopt;
    const Vec off{fit->at[0] - p[0], fit->at[1] - p[1]};
    if (std::hypot(off[0], off[1]) > kReturn) return std::nullopt;
    // Half of what the way back missed by: the errors of whole pixels cancel.
    const Vec move = times(forth, off);
    return Vec{q[0] - 0.5 * move[0], q[1] - 0.5 * move[1]};
  }

  /// Drops the matches that lie elsewhere across the epipolar direction than most; all of them if
  /// most do not agree.
  void keep_the_mode(const std::vector<Vec>& points, std::vector<std::optional<Vec>>& found) const {
    std::vector<std::pair<double, std::size_t>> offsets;
    for (std::size_t k = 0; k < points.size(); ++k) {
      if (!found[k]) continue;
      const Vec& p = points[k];
      const auto j = map_.jacobian(p[0], p[1], heights_.middle());
      const double length = std::max(1e-12, std::hypot(j[0][2], j[1][2]));
      const Vec at = seen(p, heights_.middle());
      const double offset =
          (j[0][2] * ((*found[k])[1] - at[1]) - j[1][2] * ((*found[k])[0] - at[0])) / length;
      if (std::isfinite(offset))
        offsets.push_back({offset, k});
      else
        found[k].reset();
    }
    std::sort(offsets.begin(), offsets.end());
    std::size_t begin = 0, most = 0;
    double mode = 0;
    for (std::size_t end = 0; end < offsets.size(); ++end) {
      while (offsets[end].first - offsets[begin].first > 2 * kMode) ++begin;
      if (end - begin + 1 > most) {
        most = end - begin + 1;
        mode = offsets[(begin + end) / 2].first;
      }
    }
    const auto believed = [&](double offset) { return std::abs(offset - mode) <= kSpread; };
    const auto kept = std::count_if(offsets.begin(), offsets.end(),
                                    [&](const auto& match) { return believed(match.first); });
    const bool any = static_cast<double>(kept) >= (kept >= kMany ? kMajorityOfMany : kMajority) *
                                                      static_cast<double>(offsets.size());
    for (const auto& [offset, k] : offsets)
      if (!any || !believed(offset)) found[k].reset();
  }

  const std::vector<Grey>&a_, &b_;
  const Quadratic& map_;
  rpc::HeightRange heights_;
  double reach_;  // px by which two images together may be off
};

}  // namespace

std::vector<TiePoint> find_tie_points(const std::vector<View>& views,
                                      const rpc::HeightRange& height_range, double largest_px,
                                      const std::function<void()>& poll) {
  Index largest = 0;
  for (const View& v : views) largest = std::max({largest, v.height(), v.width()});
  const auto levels = static_cast<Index>(std::max(
                          0.0, std::ceil(std::log2(static_cast<double>(largest) / kCoarse)))) +
                      1;
  std::vector<std::vector<Grey>> pyramids;
  for (const View& v : views) pyramids.push_back(grey_pyramid(v, levels));

  const rpc::LocalFrame ellipsoid;  // heights are already above it
  std::vector<TiePoint> out;
  for (std::size_t i = 0; i + 1 < views.size(); ++i) {
    const View& view = views[i];
    // Corners of the next level: noise of single pixels is none.
    const Index level = std::min<Index>(1, levels - 1);
    const Grey& image = pyramids[i][static_cast<std::size_t>(level)];
    const Index cell = std::max<Index>(4, std::max(image.width, image.height) / kCorners);
    std::vector<Vec> points = spread_corners(image, cell, kRadius);
    for (Vec& p : points) p = from_level(p, level);
    std::vector<TiePoint> tracks;
    for (const Vec& p : points) tracks.push_back({{{i, {p[0], p[1]}}}});
    for (std::size_t j = i + 1; j < views.size(); ++j) {
      if (poll) poll();
      if (common_ground(view.rpc, view.width(), view.height(), views[j].rpc, views[j].width(),
                        views[j].height(), height_range.middle())
              .both.empty())
        continue;
      const rpc::Window whole{0, 0, static_cast<double>(view.width()),
                              static_cast<double>(view.height())};
      const Quadratic map =
          rpc::fit_transfer(view.rpc, views[j].rpc, ellipsoid, whole, height_range);
      const auto found =
          Pair(pyramids[i], pyramids[j], map, height_range, largest_px).match(points);
      for (std::size_t k = 0; k < points.size(); ++k)
        if (found[k]) tracks[k].sightings.push_back({j, {(*found[k])[0], (*found[k])[1]}});
    }
    for (TiePoint& t : tracks)
      if (t.sightings.size() > 1) out.push_back(std::move(t));
  }
  return out;
}

}  // namespace satsurf::scene

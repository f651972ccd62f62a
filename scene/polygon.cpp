// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/polygon.h"

#include "satsurf/core/error.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace satsurf::scene {
namespace {

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
  if (area == 0) throw Error("polygon_centroid: no area, expected a polygon");
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

Polygon counter_clockwise(Polygon corners) {
  if (signed_area2(corners) < 0) std::reverse(corners.begin(), corners.end());
  return corners;
}

Polygon convex_hull(std::vector<std::array<double, 2>> points) {
  std::sort(points.begin(), points.end());
  Polygon out;
  // The lower half from west to east, then the upper one back.
  for (int half = 0; half < 2; ++half) {
    const std::size_t begin = out.size();
    for (const auto& p : points) {
      while (out.size() >= begin + 2 && cross(out[out.size() - 2], out.back(), p) <= 0)
        out.pop_back();
      out.push_back(p);
    }
    if (!out.empty()) out.pop_back();  // the other half begins with it
    std::reverse(points.begin(), points.end());
  }
  if (out.size() < 3) out.clear();
  return out;
}

Polygon corners_of(const Ground& g) {
  return {{g.x0, g.y0}, {g.x1, g.y0}, {g.x1, g.y1}, {g.x0, g.y1}};
}

Ground bounds_of(const Polygon& polygon) {
  Ground out{INFINITY, INFINITY, -INFINITY, -INFINITY};
  for (const auto& [x, y] : polygon)
    out = {std::min(out.x0, x), std::min(out.y0, y), std::max(out.x1, x), std::max(out.y1, y)};
  return out;
}

bool contains(const Polygon& polygon, double x, double y) {
  for (std::size_t i = 0; i < polygon.size(); ++i)
    if (cross(polygon[i], polygon[(i + 1) % polygon.size()], {x, y}) < 0) return false;
  return !polygon.empty();
}

}  // namespace satsurf::scene

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

}  // namespace satsurf::scene

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/mesh/compare.h"

#include "satsurf/core/error.h"
#include "satsurf/core/parallel.h"
#include "satsurf/core/rng.h"
#include "satsurf/mesh/geometry.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <nanoflann.hpp>

namespace satsurf::mesh {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr std::array<double, 3> kThresholds{0.5, 1, 2.5};  // m
constexpr double kLevel = 0.5;                             // |n_z| of a face that is no wall

Point along(const Point& a, const Point& d, double t) {
  return {a[0] + t * d[0], a[1] + t * d[1], a[2] + t * d[2]};
}

/// Squared distance of a point from a segment.
double from_segment(const Point& p, const Point& a, const Point& b) {
  const Point d = b - a;
  const double square = dot(d, d),
               t = square > 0 ? std::clamp(dot(p - a, d) / square, 0.0, 1.0) : 0;
  const Point off = p - along(a, d, t);
  return dot(off, off);
}

/// Squared distance of a point from a triangle: to its plane if the foot lies inside, else to the
/// nearest edge.
double from_triangle(const Point& p, const std::array<Point, 3>& c) {
  const Point n = doubled_area(c);
  const double square = dot(n, n);
  if (square > 0) {
    bool inside = true;
    for (std::size_t i = 0; i < 3; ++i)
      inside = inside && dot(cross(c[(i + 1) % 3] - c[i], p - c[i]), n) >= 0;
    if (inside) return dot(p - c[0], n) * dot(p - c[0], n) / square;
  }
  return std::min(
      {from_segment(p, c[0], c[1]), from_segment(p, c[1], c[2]), from_segment(p, c[2], c[0])});
}

/// Samples for nanoflann.
struct Cloud {
  const std::vector<std::array<float, 3>>& points;
  std::size_t kdtree_get_point_count() const { return points.size(); }
  float kdtree_get_pt(std::size_t i, std::size_t axis) const { return points[i][axis]; }
  template <class Box>
  bool kdtree_get_bbox(Box&) const {
    return false;
  }
};
using Tree = nanoflann::KDTreeSingleIndexAdaptor<nanoflann::L2_Simple_Adaptor<float, Cloud, double>,
                                                 Cloud, 3, std::uint32_t>;

/// Distances of `from` from a mesh that has the samples `to`, capped.
std::vector<double> distances(const Samples& from, const Mesh& mesh, const Samples& to,
                              double cap) {
  constexpr std::size_t kNearest = 4;
  const Cloud cloud{to.points};
  const Tree tree(3, cloud, nanoflann::KDTreeSingleIndexAdaptorParams(16));
  std::vector<double> out(from.points.size());
  for_range(static_cast<Index>(out.size()), 1024, [&](Index begin, Index end) {
    for (auto s = static_cast<std::size_t>(begin); s < static_cast<std::size_t>(end); ++s) {
      std::array<std::uint32_t, kNearest> near{};
      std::array<double, kNearest> square{};
      const std::size_t found =
          tree.knnSearch(from.points[s].data(), kNearest, near.data(), square.data());
      double best = square[0];
      for (std::size_t i = 0; i < found; ++i)
        best =
            std::min(best, from_triangle(wide(from.points[s]), corners(mesh, to.faces[near[i]])));
      out[s] = std::min(std::sqrt(best), cap);
    }
  });
  return out;
}

double mean(const std::vector<double>& v) {
  double sum = 0;
  for (const double x : v) sum += x;
  return sum / static_cast<double>(v.size());
}
double share_below(const std::vector<double>& v, double limit) {
  return static_cast<double>(
             std::count_if(v.begin(), v.end(), [&](double x) { return x < limit; })) /
         static_cast<double>(v.size());
}

Samples without_walls(const Samples& all, const Mesh& mesh) {
  Samples out;
  for (std::size_t s = 0; s < all.points.size(); ++s) {
    const Point n = doubled_area(corners(mesh, all.faces[s]));
    if (!(std::abs(n[2]) > kLevel * std::sqrt(dot(n, n)))) continue;
    out.points.push_back(all.points[s]);
    out.faces.push_back(all.faces[s]);
  }
  return out;
}

SurfaceScores score(const Mesh& mesh, const Samples& p, const Mesh& reference, const Samples& g,
                    double cap) {
  SurfaceScores s;
  s.mesh_samples = static_cast<Index>(p.points.size());
  s.reference_samples = static_cast<Index>(g.points.size());
  if (p.points.empty() || g.points.empty()) {
    s.chamfer = s.to_reference = s.to_mesh = kNan;
    for (std::size_t i = 0; i < s.f.size(); ++i) s.f[i] = {kThresholds[i], kNan, kNan, kNan};
    return s;
  }
  const auto to_reference = distances(p, reference, g, cap), to_mesh = distances(g, mesh, p, cap);
  s.to_reference = mean(to_reference);
  s.to_mesh = mean(to_mesh);
  s.chamfer = 0.5 * (s.to_reference + s.to_mesh);
  for (std::size_t i = 0; i < s.f.size(); ++i) {
    FScore& f = s.f[i];
    f.threshold = kThresholds[i];
    f.precision = share_below(to_reference, f.threshold);
    f.recall = share_below(to_mesh, f.threshold);
    const double sum = f.precision + f.recall;
    f.f1 = sum > 0 ? 2 * f.precision * f.recall / sum : 0;
  }
  return s;
}

}  // namespace

Samples sample_surface(const Mesh& mesh, const CompareOptions& options) {
  std::vector<double> until(mesh.faces.size());  // area up to and with each face
  double area = 0;
  for (std::size_t f = 0; f < until.size(); ++f) {
    const Point n = doubled_area(corners(mesh, static_cast<std::uint32_t>(f)));
    until[f] = area += 0.5 * std::sqrt(dot(n, n));
  }
  if (!(area > 0) || !std::isfinite(area))
    throw Error("sample_surface: " + std::to_string(mesh.faces.size()) +
                " faces without area, expected a surface");
  const double wanted = std::ceil(area * options.density);
  const auto n = static_cast<std::size_t>(
      std::clamp(wanted, 1.0, static_cast<double>(std::max<Index>(1, options.most))));
  Samples out;
  out.points.reserve(n);
  out.faces.reserve(n);
  Rng rng(options.seed);
  std::size_t face = 0;
  for (std::size_t s = 0; s < n; ++s) {
    const double at = (static_cast<double>(s) + rng.uniform()) / static_cast<double>(n) * area;
    while (face + 1 < until.size() && until[face] <= at) ++face;
    const auto c = corners(mesh, static_cast<std::uint32_t>(face));
    const double root = std::sqrt(rng.uniform()), b = rng.uniform();
    const Point p = along(along(c[0], c[1] - c[0], root * (1 - b)), c[2] - c[0], root * b);
    out.points.push_back(
        {static_cast<float>(p[0]), static_cast<float>(p[1]), static_cast<float>(p[2])});
    out.faces.push_back(static_cast<std::uint32_t>(face));
  }
  return out;
}

MeshComparison compare_meshes(const Mesh& mesh, const Mesh& reference,
                              const CompareOptions& options) {
  const Samples p = sample_surface(mesh, options), g = sample_surface(reference, options);
  return {score(mesh, p, reference, g, options.cap),
          score(mesh, without_walls(p, mesh), reference, without_walls(g, reference), options.cap)};
}

}  // namespace satsurf::mesh

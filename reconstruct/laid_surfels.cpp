// SPDX-License-Identifier: Apache-2.0
#include "satsurf/reconstruct/laid_surfels.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"
#include "satsurf/reconstruct/cell_slopes.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <utility>

#include <Eigen/Dense>

namespace satsurf::reconstruct {
namespace {

using Eigen::Vector3d;

constexpr Index kGrain = 1 << 12;  // surfels of one piece of work
// A little less than what facing discs have: those of several views cover a wall better now.
constexpr float kOpacity = 0.3F;
constexpr double kLeastCosine = 0.42261826;  // of 65 degrees
// The pixel filter's deviation of sqrt(1/2) px over the discs' 0.6 px: beyond it a view of the same
// resolution is blurred.
constexpr double kMostGrowth = 1.1785113;

struct Cell {
  Index row, column;
};

/// A place of the surface.
struct Patch {
  Vector3d normal;  ///< of length 1
  bool wall;
  double rise;  ///< m of height from the place to the plane
};

/// A surface of columns with what its cells and walls face.
class Facets {
 public:
  /// Keeps a reference to the surface.
  explicit Facets(const scene::HeightField& surface)
      : surface_(surface), slopes_(cell_slopes(surface)) {}

  /// Where a ray ends; nothing on unknown cells.
  /// east, north  that the ray moves per metre of height
  std::optional<Patch> at(const Vector3d& place, double east, double north) const {
    // A ray that ends on a wall ends between two columns.
    const double length = std::hypot(east, north),
                 aside = length > 0 ? 0.02 * surface_.step / length : 0;
    const Cell cell = cell_of(place.x() - aside * east, place.y() - aside * north),
               front = cell_of(place.x() + aside * east, place.y() + aside * north);
    const double top = height(cell);
    if (!std::isfinite(top)) return std::nullopt;
    if (place.z() < top && is_wall(cell, front)) return Patch{wall_normal(cell, front), true, 0};
    const Vector3d normal(-slope(cell, 0), -slope(cell, 1), 1);
    return Patch{normal.normalized(), false, rise(cell, place)};
  }

 private:
  Cell cell_of(double x, double y) const {
    const auto index = [this](double distance, Index count) {
      return std::clamp<Index>(static_cast<Index>(std::floor(distance / surface_.step)), 0,
                               count - 1);
    };
    return {index(surface_.y0 - y, surface_.z.dim(0)), index(x - surface_.x0, surface_.z.dim(1))};
  }
  Index number(const Cell& c) const { return c.row * surface_.z.dim(1) + c.column; }
  double height(const Cell& c) const { return static_cast<double>(surface_.z[number(c)]); }
  double slope(const Cell& c, Index axis) const {
    return static_cast<double>(slopes_[2 * number(c) + axis]);
  }

  /// Whether the column in front is lower than the plane of a cell says.
  bool is_wall(const Cell& cell, const Cell& front) const {
    const double columns = static_cast<double>(front.column - cell.column),
                 rows = static_cast<double>(cell.row - front.row);
    const double expected =
        height(cell) + surface_.step * (columns * slope(cell, 0) + rows * slope(cell, 1));
    return expected - height(front) > plane_tolerance(surface_.step);
  }

  /// Away from the middle of the columns around that are as high as the cell, not as the front one.
  Vector3d wall_normal(const Cell& cell, const Cell& front) const {
    constexpr Index kReach = 2;  // the edges of cells alone know four directions
    const double middle = 0.5 * (height(cell) + height(front));
    Vector3d normal(0, 0, 0);
    for (Index v = -kReach; v <= kReach; ++v)
      for (Index u = -kReach; u <= kReach; ++u) {
        const Cell c{cell.row + v, cell.column + u};
        if (c.row < 0 || c.column < 0 || c.row >= surface_.z.dim(0) ||
            c.column >= surface_.z.dim(1))
          continue;
        if (height(c) > middle)
          normal += Vector3d(-static_cast<double>(u), static_cast<double>(v), 0);
      }
    if (normal.squaredNorm() < 0.5)  // a column as thin as it is long
      normal = Vector3d(static_cast<double>(front.column - cell.column),
                        static_cast<double>(cell.row - front.row), 0);
    return normal.normalized();
  }

  /// 0 where the plane is farther than a cell's side: it is too steep for what the columns say.
  double rise(const Cell& cell, const Vector3d& place) const {
    const double x = surface_.x0 + (static_cast<double>(cell.column) + 0.5) * surface_.step,
                 y = surface_.y0 - (static_cast<double>(cell.row) + 0.5) * surface_.step;
    const double gap = height(cell) + slope(cell, 0) * (place.x() - x) +
                       slope(cell, 1) * (place.y() - y) - place.z();
    return std::abs(gap) <= surface_.step ? gap : 0;
  }

  const scene::HeightField& surface_;
  Tensor slopes_;
};

/// A normal at most 65 degrees off a ray, in the plane of both.
Vector3d turned_to(const Vector3d& ray, const Vector3d& normal) {
  const double cosine = normal.dot(ray);
  if (cosine >= kLeastCosine) return normal;
  return kLeastCosine * ray +
         std::sqrt(1 - kLeastCosine * kLeastCosine) * (normal - cosine * ray).normalized();
}

/// The numbers of one surfel.
struct Disc {
  float *mean, *quat, *scales;
};

void lay(const Facets& facets, const Disc& disc) {
  const Eigen::Quaterniond facing(
      static_cast<double>(disc.quat[0]), static_cast<double>(disc.quat[1]),
      static_cast<double>(disc.quat[2]), static_cast<double>(disc.quat[3]));
  Vector3d ray = facing.normalized() * Vector3d(0, 0, 1);
  if (ray.z() < 0) ray = -ray;
  const auto patch =
      facets.at(Vector3d(static_cast<double>(disc.mean[0]), static_cast<double>(disc.mean[1]),
                         static_cast<double>(disc.mean[2])),
                ray.x() / ray.z(), ray.y() / ray.z());
  if (!patch) return;
  disc.mean[2] += static_cast<float>(patch->rise);
  const Vector3d normal = turned_to(ray, patch->normal), across = ray.cross(normal);
  if (across.norm() < 1e-6) return;  // it faces the camera
  Eigen::Matrix3d frame;
  frame.col(0) = across.normalized();
  frame.col(1) = normal.cross(frame.col(0));
  frame.col(2) = normal;
  const Eigen::Quaterniond q(frame);
  const std::array<double, 4> numbers{q.w(), q.x(), q.y(), q.z()};
  std::transform(numbers.begin(), numbers.end(), disc.quat,
                 [](double v) { return static_cast<float>(v); });
  const double longer = 1 / normal.dot(ray);
  disc.scales[1] *= static_cast<float>(patch->wall ? longer : std::min(longer, kMostGrowth));
}

}  // namespace

splat::Surfels laid_in(const splat::Surfels& surfels, const scene::HeightField& surface) {
  Dims dim("laid_in");
  dim.match("means", surfels.means.value(), "P 3").match("quats", surfels.quats.value(), "P 4");
  dim.match("scales", surfels.scales.value(), "P 2");
  const Index P = dim["P"];
  const Facets facets(surface);
  Tensor means = surfels.means.value().clone(), quats = surfels.quats.value().clone(),
         scales = surfels.scales.value().clone();
  for_range(P, kGrain, [&](Index begin, Index end) {
    for (Index k = begin; k < end; ++k)
      lay(facets, {means.data() + 3 * k, quats.data() + 4 * k, scales.data() + 2 * k});
  });
  splat::Surfels laid = surfels;
  laid.means = Var(std::move(means)), laid.quats = Var(std::move(quats));
  laid.scales = Var(std::move(scales)), laid.opacity = Var(Tensor({P}, kOpacity));
  return laid;
}

splat::Surfels delivered_surfels(const Reconstruction& made) {
  return made.sigma.empty() ? made.surfels : laid_in(made.surfels, made.dsm);
}

}  // namespace satsurf::reconstruct

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/pointing_adjustment.h"

#include "satsurf/core/error.h"
#include "satsurf/core/parallel.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <utility>

#include <Eigen/Dense>

namespace satsurf::scene {
namespace {

using Normal = Eigen::Matrix3d;

/// Steps on the ground in metres, so that the three unknowns of a point have one unit.
struct GroundScale {
  double lon, lat;  // degrees per m
  explicit GroundScale(double at_lat)
      : lon(1 / (111320 * std::cos(at_lat * std::numbers::pi / 180))), lat(1 / 110574.0) {}
  void move(rpc::Geodetic& p, const Eigen::Vector3d& by) const {
    p.lon += by[0] * lon, p.lat += by[1] * lat, p.h += by[2];
  }
  /// d(pixel)/d(east, north, up), px per m
  Eigen::Matrix<double, 2, 3> jacobian(const rpc::Rpc& camera, const rpc::Geodetic& p) const {
    const rpc::PixelJacobian j = camera.jacobian(p);
    Eigen::Matrix<double, 2, 3> out;
    for (int r = 0; r < 2; ++r) {
      const auto& row = j[static_cast<std::size_t>(r)];
      out.row(r) << row[0] * lon, row[1] * lat, row[2];
    }
    return out;
  }
};

/// A tie point on its way to where it lies.
struct Track {
  const TiePoint* tie = nullptr;
  rpc::Geodetic ground;
  std::vector<double> weight;             // of each sighting
  std::vector<Eigen::Vector2d> residual;  // seen minus predicted, px
  std::vector<std::array<double, 3>> at;  // the functions of the place where it is predicted
  std::vector<Eigen::Matrix<double, 2, 3>> jacobian;
};

/// Where a camera's sightings lie in its image, px.
struct Extent {
  rpc::Pixel middle, reach{1, 1};
};

std::vector<Extent> extents_of(std::size_t cameras, const std::vector<TiePoint>& points) {
  std::vector<rpc::Pixel> least(cameras, {INFINITY, INFINITY}),
      most(cameras, {-INFINITY, -INFINITY});
  for (const TiePoint& point : points)
    for (const Sighting& s : point.sightings) {
      rpc::Pixel &low = least[s.view], &high = most[s.view];
      low = {std::min(low.x, s.pixel.x), std::min(low.y, s.pixel.y)};
      high = {std::max(high.x, s.pixel.x), std::max(high.y, s.pixel.y)};
    }
  std::vector<Extent> out(cameras);
  for (std::size_t i = 0; i < cameras; ++i) {
    if (!(least[i].x <= most[i].x)) continue;
    out[i].middle = {(least[i].x + most[i].x) / 2, (least[i].y + most[i].y) / 2};
    out[i].reach = {std::max(1.0, (most[i].x - least[i].x) / 2),
                    std::max(1.0, (most[i].y - least[i].y) / 2)};
  }
  return out;
}

/// Holds a point on its ray where two rays are parallel; far below what any parallax of use gives.
constexpr double kDamping = 1e-9;  // px^2/m^2

/// What cameras are off by: for each of them the shift, x and y, in the middle of its sightings, and if
/// it has slopes what it changes by from there to the right and to the lower end of these.
using Offsets = Eigen::VectorXd;

class Bundle {
 public:
  /// functions  of the place in an image that the offsets are of: 1, or 3 with slopes
  Bundle(const std::vector<rpc::Rpc>& cameras, const std::vector<TiePoint>& points, double height,
         Eigen::Index functions = 1)
      : cameras_(cameras),
        scale_(cameras.front().lat_off),
        functions_(functions),
        extents_(extents_of(cameras.size(), points)),
        tracks_(points.size()) {
    each([&](Track& t, std::size_t k) {
      t.tie = &points[k];
      const std::size_t n = t.tie->sightings.size();
      const Sighting& first = t.tie->sightings.front();
      t.ground = cameras_[first.view].localize(first.pixel, height);
      t.weight.assign(n, 1);
      t.residual.resize(n);
      t.at.resize(n);
      t.jacobian.resize(n);
    });
  }

  const std::vector<Track>& tracks() const { return tracks_; }
  const std::vector<Extent>& extents() const { return extents_; }
  Eigen::Index unknowns() const {
    return 2 * functions_ * static_cast<Eigen::Index>(cameras_.size());
  }

  /// Moves every point to where its weighted rays meet best.
  void triangulate(const Offsets& offsets, int steps) {
    each([&](Track& t, std::size_t) {
      look(t, offsets);
      for (int step = 0; step < steps; ++step) {
        Normal n = kDamping * Normal::Identity();
        Eigen::Vector3d g = Eigen::Vector3d::Zero();
        for (std::size_t i = 0; i < t.weight.size(); ++i) {
          n += t.weight[i] * t.jacobian[i].transpose() * t.jacobian[i];
          g += t.weight[i] * t.jacobian[i].transpose() * t.residual[i];
        }
        scale_.move(t.ground, n.ldlt().solve(g));
        look(t, offsets);
      }
    });
  }

  /// Cauchy weights of the residuals now, at a scale taken from them.
  void weigh() {
    constexpr double kLeastScale = 0.1;  // px; what a good match is off by
    std::vector<double> sizes;
    for (const Track& t : tracks_)
      for (const auto& r : t.residual) sizes.push_back(r.norm());
    const auto middle = sizes.begin() + static_cast<std::ptrdiff_t>(sizes.size() / 2);
    std::nth_element(sizes.begin(), middle, sizes.end());
    const double scale = std::max(kLeastScale, 0.7 * *middle);
    each([&](Track& t, std::size_t) {
      for (std::size_t i = 0; i < t.weight.size(); ++i)
        t.weight[i] = 1 / (1 + t.residual[i].squaredNorm() / (scale * scale));
    });
  }

  /// Normal equations of the offsets alone, every point eliminated. `offsets` are those the residuals
  /// were taken with; the solution is the whole offset, not a step.
  void reduce(const Offsets& offsets, Eigen::MatrixXd& N, Eigen::VectorXd& g) const {
    N.setZero(unknowns(), unknowns());
    g.setZero(unknowns());
    for (const Track& t : tracks_) {
      const auto m = static_cast<Eigen::Index>(t.weight.size());
      Eigen::MatrixXd J(2 * m, 3);
      Eigen::VectorXd y(2 * m), w(2 * m);
      for (Eigen::Index i = 0; i < m; ++i) {
        const auto k = static_cast<std::size_t>(i);
        J.middleRows<2>(2 * i) = t.jacobian[k];
        y.segment<2>(2 * i) = t.residual[k] + offset_at(offsets, t.tie->sightings[k].view, t.at[k]);
        w.segment<2>(2 * i).setConstant(t.weight[k]);
      }
      // M = W - W J (J' W J)^-1 J' W: what is left of the sightings once the point follows them
      const Eigen::MatrixXd WJ = w.asDiagonal() * J;
      const Normal inner = J.transpose() * WJ + kDamping * Normal::Identity();
      Eigen::MatrixXd M = -WJ * inner.ldlt().solve(WJ.transpose());
      M.diagonal() += w;
      const Eigen::VectorXd My = M * y;
      const auto first = [&](Eigen::Index row) {  // unknown of its view and axis
        const auto view =
            static_cast<Eigen::Index>(t.tie->sightings[static_cast<std::size_t>(row / 2)].view);
        return 2 * functions_ * view + row % 2;
      };
      const auto value = [&](Eigen::Index row, Eigen::Index function) {
        return t.at[static_cast<std::size_t>(row / 2)][static_cast<std::size_t>(function)];
      };
      for (Eigen::Index r = 0; r < 2 * m; ++r)
        for (Eigen::Index a = 0; a < functions_; ++a) {
          const Eigen::Index row = first(r) + 2 * a;
          g(row) += value(r, a) * My(r);
          for (Eigen::Index c = 0; c < 2 * m; ++c)
            for (Eigen::Index b = 0; b < functions_; ++b)
              N(row, first(c) + 2 * b) += value(r, a) * value(c, b) * M(r, c);
        }
    }
  }

  /// Orthonormal columns that span the offsets whose displacements of the ground in the middle of the
  /// points have a mean of zero. Displacements and not pixels: one image may be turned against
  /// another, or coarser.
  Eigen::MatrixXd offsets_that_leave_the_ground() const {
    const double lon0 = tracks_.front().ground.lon;  // they may lie across the antimeridian
    rpc::Geodetic middle{lon0, 0, 0};
    for (const Track& t : tracks_) {
      const double share = 1 / static_cast<double>(tracks_.size());
      middle.lon += share * std::remainder(t.ground.lon - lon0, 360);
      middle.lat += share * t.ground.lat, middle.h += share * t.ground.h;
    }
    Eigen::MatrixXd ground_from_offsets(2, unknowns());
    for (std::size_t i = 0; i < cameras_.size(); ++i) {
      const Eigen::Matrix2d plane = scale_.jacobian(cameras_[i], middle).leftCols<2>();
      const auto at = functions_at(i, cameras_[i].project(middle));
      for (Eigen::Index f = 0; f < functions_; ++f)
        ground_from_offsets.middleCols<2>(2 * (functions_ * static_cast<Eigen::Index>(i) + f)) =
            at[static_cast<std::size_t>(f)] * plane.inverse();
    }
    const Eigen::MatrixXd all =
        Eigen::HouseholderQR<Eigen::MatrixXd>(ground_from_offsets.transpose()).householderQ();
    return all.rightCols(unknowns() - 2);
  }

  double mean_weight_of_a_view() const {
    double sum = 0;
    for (const Track& t : tracks_)
      for (const double w : t.weight) sum += w;
    return sum / static_cast<double>(cameras_.size());
  }

 private:
  std::array<double, 3> functions_at(std::size_t view, const rpc::Pixel& p) const {
    const Extent& e = extents_[view];
    return {1, (p.x - e.middle.x) / e.reach.x, (p.y - e.middle.y) / e.reach.y};
  }

  Eigen::Vector2d offset_at(const Offsets& offsets, std::size_t view,
                            const std::array<double, 3>& at) const {
    Eigen::Vector2d sum = Eigen::Vector2d::Zero();
    for (Eigen::Index f = 0; f < functions_; ++f)
      sum += at[static_cast<std::size_t>(f)] *
             offsets.segment<2>(2 * (functions_ * static_cast<Eigen::Index>(view) + f));
    return sum;
  }

  /// Residuals and derivatives where the point lies now.
  void look(Track& t, const Offsets& offsets) const {
    for (std::size_t i = 0; i < t.weight.size(); ++i) {
      const Sighting& s = t.tie->sightings[i];
      const rpc::Pixel p = cameras_[s.view].project(t.ground);
      t.at[i] = functions_at(s.view, p);
      const Eigen::Vector2d off = offset_at(offsets, s.view, t.at[i]);
      t.residual[i] = {s.pixel.x - p.x - off[0], s.pixel.y - p.y - off[1]};
      t.jacobian[i] = scale_.jacobian(cameras_[s.view], t.ground);
    }
  }

  template <class Body>
  void each(const Body& body) {
    for_range(static_cast<Index>(tracks_.size()), 64, [&](Index begin, Index end) {
      for (Index k = begin; k < end; ++k)
        body(tracks_[static_cast<std::size_t>(k)], static_cast<std::size_t>(k));
    });
  }

  const std::vector<rpc::Rpc>& cameras_;
  GroundScale scale_;
  Eigen::Index functions_;
  std::vector<Extent> extents_;
  std::vector<Track> tracks_;
};

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// Distance of sighting j from the ray of sighting i at the height of the point, px: along and
/// across the direction in which that ray runs through image j.
std::array<double, 2> along_and_across(const Track& t, std::size_t i, std::size_t j) {
  const Eigen::Matrix2d plane_i = t.jacobian[i].leftCols<2>(),
                        plane_j = t.jacobian[j].leftCols<2>();
  const Eigen::Matrix2d j_from_i = plane_j * plane_i.inverse();
  const Eigen::Vector2d off = t.residual[j] - j_from_i * t.residual[i];
  Eigen::Vector2d ray = t.jacobian[j].col(2) - j_from_i * t.jacobian[i].col(2);
  ray.normalize();
  return {ray.dot(off), ray[0] * off[1] - ray[1] * off[0]};
}

}  // namespace

TieResiduals tie_residuals(const std::vector<rpc::Rpc>& cameras,
                           const std::vector<rpc::Pixel>& shifts,
                           const std::vector<TiePoint>& points, double height) {
  constexpr int kSteps = 4;  // the rays are all but straight
  Bundle bundle(cameras, points, height);
  Offsets offsets(bundle.unknowns());
  for (std::size_t i = 0; i < shifts.size(); ++i)
    offsets.segment<2>(2 * static_cast<Eigen::Index>(i)) << shifts[i].x, shifts[i].y;
  bundle.triangulate(offsets, kSteps);
  const std::size_t n = cameras.size();
  std::vector<std::vector<double>> across(n * n), along(n * n);
  for (const Track& t : bundle.tracks())
    for (std::size_t i = 0; i < t.weight.size(); ++i)
      for (std::size_t j = i + 1; j < t.weight.size(); ++j) {
        const std::size_t pair = t.tie->sightings[i].view * n + t.tie->sightings[j].view;
        const auto [parallel, square] = along_and_across(t, i, j);
        across[pair].push_back(std::abs(square));
        if (t.weight.size() > 2) along[pair].push_back(std::abs(parallel));
      }
  TieResiduals out;
  for (const Track& t : bundle.tracks()) out.heights.push_back(t.ground.h);
  for (std::size_t a = 0; a < n; ++a)
    for (std::size_t b = a + 1; b < n; ++b) {
      const std::size_t pair = a * n + b;
      PairResidual r{.a = a, .b = b, .ties = static_cast<Index>(across[pair].size()), .along = {}};
      if (r.ties > 0) r.across = median(std::move(across[pair]));
      if (!along[pair].empty()) r.along = median(std::move(along[pair]));
      out.pairs.push_back(r);
    }
  return out;
}

PointingAdjustment adjust_pointing(const std::vector<rpc::Rpc>& cameras,
                                   const std::vector<TiePoint>& points, double height,
                                   bool affine) {
  constexpr int kMostPasses = 25;
  constexpr double kStill = 1e-3;  // px; below it the shifts have settled
  // A shift of one pixel that leaves the rays less than a tenth of a pixel apart is not told from a
  // ground that lies elsewhere: the cameras differ by that much only through their curvature.
  constexpr double kUnseen = 0.1 * 0.1;
  if (points.empty() || cameras.size() < 2)
    throw Error("adjust_pointing: " + std::to_string(points.size()) + " points in " +
                std::to_string(cameras.size()) + " images, expected some in two or more");
  PointingAdjustment out;
  const Eigen::Index functions = affine ? 3 : 1;
  Bundle bundle(cameras, points, height, functions);
  Offsets offsets = Offsets::Zero(bundle.unknowns());
  bundle.triangulate(offsets, 3);

  const Eigen::MatrixXd free = bundle.offsets_that_leave_the_ground();
  Eigen::MatrixXd N;
  Eigen::VectorXd g;
  for (int pass = 0; pass < kMostPasses; ++pass) {
    bundle.reduce(offsets, N, g);
    const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(free.transpose() * N * free);
    const Eigen::VectorXd wanted = eigen.eigenvectors().transpose() * (free.transpose() * g);
    Eigen::VectorXd solution = Eigen::VectorXd::Zero(wanted.size());
    const double least = kUnseen * bundle.mean_weight_of_a_view();
    out.observable = 0;
    for (Eigen::Index k = 0; k < wanted.size(); ++k) {
      if (eigen.eigenvalues()[k] < least) continue;
      solution[k] = wanted[k] / eigen.eigenvalues()[k];
      ++out.observable;
    }
    const Offsets next = free * (eigen.eigenvectors() * solution);
    double moved = 0;
    for (Eigen::Index i = 0; i < next.size(); i += 2)
      moved = std::max(moved, std::hypot(next[i] - offsets[i], next[i + 1] - offsets[i + 1]));
    offsets = next;
    bundle.triangulate(offsets, 1);
    if (pass > 0 && moved < kStill) break;
    bundle.weigh();
    bundle.triangulate(offsets, 1);
  }
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    const Eigen::Index at = 2 * functions * static_cast<Eigen::Index>(i);
    out.shifts.push_back({offsets[at], offsets[at + 1]});
    if (!affine) continue;
    const auto& [middle, reach] = bundle.extents()[i];
    out.slopes.push_back({middle,
                          {{{offsets[at + 2] / reach.x, offsets[at + 4] / reach.y},
                            {offsets[at + 3] / reach.x, offsets[at + 5] / reach.y}}}});
  }
  return out;
}

}  // namespace satsurf::scene

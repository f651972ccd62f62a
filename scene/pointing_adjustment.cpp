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
  std::vector<Eigen::Matrix<double, 2, 3>> jacobian;
};

/// Holds a point on its ray where two rays are parallel; far below what any parallax of use gives.
constexpr double kDamping = 1e-9;  // px^2/m^2

class Bundle {
 public:
  Bundle(const std::vector<rpc::Rpc>& cameras, const std::vector<TiePoint>& points, double height)
      : cameras_(cameras), scale_(cameras.front().lat_off), tracks_(points.size()) {
    each([&](Track& t, std::size_t k) {
      t.tie = &points[k];
      const std::size_t n = t.tie->sightings.size();
      const Sighting& first = t.tie->sightings.front();
      t.ground = cameras_[first.view].localize(first.pixel, height);
      t.weight.assign(n, 1);
      t.residual.resize(n);
      t.jacobian.resize(n);
    });
  }

  const std::vector<Track>& tracks() const { return tracks_; }

  /// Moves every point to where its weighted rays meet best.
  void triangulate(const std::vector<rpc::Pixel>& shifts, int steps) {
    each([&](Track& t, std::size_t) {
      look(t, shifts);
      for (int step = 0; step < steps; ++step) {
        Normal n = kDamping * Normal::Identity();
        Eigen::Vector3d g = Eigen::Vector3d::Zero();
        for (std::size_t i = 0; i < t.weight.size(); ++i) {
          n += t.weight[i] * t.jacobian[i].transpose() * t.jacobian[i];
          g += t.weight[i] * t.jacobian[i].transpose() * t.residual[i];
        }
        scale_.move(t.ground, n.ldlt().solve(g));
        look(t, shifts);
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

  /// Normal equations of the shifts alone, every point eliminated. `shifts` are those the residuals
  /// were taken with; the solution is the whole shift, not a step.
  void reduce(const std::vector<rpc::Pixel>& shifts, Eigen::MatrixXd& N, Eigen::VectorXd& g) const {
    const auto size = static_cast<Eigen::Index>(2 * cameras_.size());
    N.setZero(size, size);
    g.setZero(size);
    for (const Track& t : tracks_) {
      const auto m = static_cast<Eigen::Index>(t.weight.size());
      Eigen::MatrixXd J(2 * m, 3);
      Eigen::VectorXd y(2 * m), w(2 * m);
      std::vector<Eigen::Index> at(static_cast<std::size_t>(2 * m));
      for (Eigen::Index i = 0; i < m; ++i) {
        const auto k = static_cast<std::size_t>(i);
        const std::size_t view = t.tie->sightings[k].view;
        J.middleRows<2>(2 * i) = t.jacobian[k];
        y.segment<2>(2 * i) = t.residual[k] + Eigen::Vector2d(shifts[view].x, shifts[view].y);
        w.segment<2>(2 * i).setConstant(t.weight[k]);
        at[2 * k] = static_cast<Eigen::Index>(2 * view), at[2 * k + 1] = at[2 * k] + 1;
      }
      // M = W - W J (J' W J)^-1 J' W: what is left of the sightings once the point follows them
      const Eigen::MatrixXd WJ = w.asDiagonal() * J;
      const Normal inner = J.transpose() * WJ + kDamping * Normal::Identity();
      Eigen::MatrixXd M = -WJ * inner.ldlt().solve(WJ.transpose());
      M.diagonal() += w;
      const Eigen::VectorXd My = M * y;
      for (Eigen::Index r = 0; r < 2 * m; ++r) {
        const Eigen::Index row = at[static_cast<std::size_t>(r)];
        g(row) += My(r);
        for (Eigen::Index c = 0; c < 2 * m; ++c) N(row, at[static_cast<std::size_t>(c)]) += M(r, c);
      }
    }
  }

  /// Orthonormal columns that span the shifts whose displacements of the ground have a mean of zero.
  /// Displacements and not pixels: one image may be turned against another, or coarser.
  Eigen::MatrixXd shifts_that_leave_the_ground() const {
    rpc::Geodetic middle;
    for (const Track& t : tracks_) {
      const double share = 1 / static_cast<double>(tracks_.size());
      middle.lon += share * t.ground.lon, middle.lat += share * t.ground.lat;
      middle.h += share * t.ground.h;
    }
    const auto size = static_cast<Eigen::Index>(2 * cameras_.size());
    Eigen::MatrixXd ground_from_shifts(2, size);
    for (std::size_t i = 0; i < cameras_.size(); ++i) {
      const Eigen::Matrix2d plane = scale_.jacobian(cameras_[i], middle).leftCols<2>();
      ground_from_shifts.middleCols<2>(static_cast<Eigen::Index>(2 * i)) = plane.inverse();
    }
    const Eigen::MatrixXd all =
        Eigen::HouseholderQR<Eigen::MatrixXd>(ground_from_shifts.transpose()).householderQ();
    return all.rightCols(size - 2);
  }

  double mean_weight_of_a_view() const {
    double sum = 0;
    for (const Track& t : tracks_)
      for (const double w : t.weight) sum += w;
    return sum / static_cast<double>(cameras_.size());
  }

 private:
  /// Residuals and derivatives where the point lies now.
  void look(Track& t, const std::vector<rpc::Pixel>& shifts) const {
    for (std::size_t i = 0; i < t.weight.size(); ++i) {
      const Sighting& s = t.tie->sightings[i];
      const rpc::Pixel p = cameras_[s.view].project(t.ground);
      t.residual[i] = {s.pixel.x - p.x - shifts[s.view].x, s.pixel.y - p.y - shifts[s.view].y};
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
  bundle.triangulate(shifts, kSteps);
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
                                   const std::vector<TiePoint>& points, double height) {
  constexpr int kMostPasses = 25;
  constexpr double kStill = 1e-3;  // px; below it the shifts have settled
  // A shift of one pixel that leaves the rays less than a tenth of a pixel apart is not told from a
  // ground that lies elsewhere: the cameras differ by that much only through their curvature.
  constexpr double kUnseen = 0.1 * 0.1;
  if (points.empty() || cameras.size() < 2)
    throw Error("adjust_pointing: " + std::to_string(points.size()) + " points in " +
                std::to_string(cameras.size()) + " images, expected some in two or more");
  const auto n = static_cast<Eigen::Index>(cameras.size());
  PointingAdjustment out;
  out.shifts.resize(cameras.size());
  Bundle bundle(cameras, points, height);
  bundle.triangulate(out.shifts, 3);

  const Eigen::MatrixXd free = bundle.shifts_that_leave_the_ground();
  Eigen::MatrixXd N;
  Eigen::VectorXd g;
  for (int pass = 0; pass < kMostPasses; ++pass) {
    bundle.reduce(out.shifts, N, g);
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
    const Eigen::VectorXd shift = free * (eigen.eigenvectors() * solution);
    double moved = 0;
    for (Eigen::Index i = 0; i < n; ++i) {
      rpc::Pixel& s = out.shifts[static_cast<std::size_t>(i)];
      moved = std::max(moved, std::hypot(shift[2 * i] - s.x, shift[2 * i + 1] - s.y));
      s = {shift[2 * i], shift[2 * i + 1]};
    }
    bundle.triangulate(out.shifts, 1);
    if (pass > 0 && moved < kStill) break;
    bundle.weigh();
    bundle.triangulate(out.shifts, 1);
  }
  return out;
}

}  // namespace satsurf::scene

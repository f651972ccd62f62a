// SPDX-License-Identifier: Apache-2.0
#include "satsurf/rpc/fit.h"

#include "satsurf/core/error.h"

#include <algorithm>
#include <cmath>
#include <sstream>
#include <vector>

#include <Eigen/QR>

namespace satsurf::rpc {
namespace {

constexpr int kAcross = 11, kHeights = 7;  // samples along x and y, and along the height range

struct Sample {
  std::array<double, 3> in;
  std::array<double, 2> out;
};

std::array<double, 10> monomials(const Quadratic& map, const std::array<double, 3>& p) {
  const double x = (p[0] - map.offset[0]) / map.scale[0], y = (p[1] - map.offset[1]) / map.scale[1],
               z = (p[2] - map.offset[2]) / map.scale[2];
  return {1, x, y, z, x * x, x * y, x * z, y * y, y * z, z * z};
}

/// Least squares on `samples`, inputs brought to [-1, 1]; the residuals of `samples` and of `check`
/// are stored, so that `max` does not only speak of the points that were fitted.
Quadratic fit(const std::vector<Sample>& samples, const std::vector<Sample>& check) {
  Quadratic map;
  for (std::size_t k = 0; k < 3; ++k) {
    double low = samples[0].in[k], high = low;
    for (const Sample& s : samples) {
      low = std::min(low, s.in[k]);
      high = std::max(high, s.in[k]);
    }
    map.offset[k] = (low + high) / 2;
    map.scale[k] = high > low ? (high - low) / 2 : 1;
  }
  const auto N = static_cast<Eigen::Index>(samples.size());
  Eigen::MatrixXd A(N, 10), b(N, 2);
  for (Eigen::Index i = 0; i < N; ++i) {
    const Sample& s = samples[static_cast<std::size_t>(i)];
    const auto m = monomials(map, s.in);
    for (Eigen::Index j = 0; j < 10; ++j) A(i, j) = m[static_cast<std::size_t>(j)];
    b(i, 0) = s.out[0];
    b(i, 1) = s.out[1];
  }
  // Orthogonal decomposition with pivots: a range of a single height leaves columns of zeros.
  const Eigen::MatrixXd c = A.completeOrthogonalDecomposition().solve(b);
  for (std::size_t k = 0; k < 2; ++k)
    for (std::size_t j = 0; j < 10; ++j)
      map.coeff[k][j] = c(static_cast<Eigen::Index>(j), static_cast<Eigen::Index>(k));

  double squares = 0, worst = 0;
  for (const auto* set : {&samples, &check})
    for (const Sample& s : *set) {
      const auto at = map(s.in[0], s.in[1], s.in[2]);
      const double error = std::hypot(at[0] - s.out[0], at[1] - s.out[1]);
      squares += error * error;
      worst = std::max(worst, error);
    }
  map.rms = std::sqrt(squares / static_cast<double>(samples.size() + check.size()));
  map.max = worst;
  return map;
}

/// `count` samples over [low, high], ends included; or the middles between them.
std::vector<double> ticks(double low, double high, int count, bool middles) {
  std::vector<double> out;
  for (int i = 0; i < count - (middles ? 1 : 0); ++i)
    out.push_back(low + (high - low) * (i + (middles ? 0.5 : 0.0)) / (count - 1));
  return out;
}

/// sample(pixel, h) over the window and the height range, on the fitting grid or between its nodes.
template <class F>
std::vector<Sample> samples_of(const Window& window, const HeightRange& range, bool middles,
                               const F& sample) {
  const double left = window.x0 - 0.5, top = window.y0 - 0.5;  // the outer edges of the pixels
  std::vector<Sample> out;
  for (const double h : ticks(range.low, range.high, kHeights, middles))
    for (const double y : ticks(top, top + window.height, kAcross, middles))
      for (const double x : ticks(left, left + window.width, kAcross, middles))
        out.push_back(sample(Pixel{x, y}, h));
  return out;
}

/// sample(pixel, h) at heights above the ellipsoid, which is how a camera takes them
template <class F>
Quadratic fit_over(const char* where, const LocalFrame& frame, const Window& window,
                   const HeightRange& z_range, const F& sample) {
  std::ostringstream text;
  if (!(window.width > 0 && window.height > 0)) {
    text << where << ": window of " << window.width << " x " << window.height
         << " px, expected a positive size";
    throw Error(text.str());
  }
  const HeightRange range = frame.heights_from_z(z_range);
  if (!(range.low <= range.high) || !std::isfinite(range.high - range.low)) {
    text << where << ": height range " << range.low << " to " << range.high
         << " m, expected finite ones, low <= high";
    throw Error(text.str());
  }
  const Quadratic map =
      fit(samples_of(window, range, false, sample), samples_of(window, range, true, sample));
  if (!std::isfinite(map.rms)) {  // any number that is not finite ends here
    text << where << ": the camera has no finite value somewhere in the window at heights "
         << range.low << " to " << range.high << " m, expected one everywhere";
    throw Error(text.str());
  }
  return map;
}

using Vec3 = std::array<double, 3>;
double dot(const Vec3& a, const Vec3& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
Vec3 unit(const Vec3& a) {
  const double length = std::sqrt(dot(a, a));
  return {a[0] / length, a[1] / length, a[2] / length};
}

/// w x y z with w >= 0 of a rotation given by its columns.
/// Source: Shepperd 1978: the largest component is found first, so no division by a small number.
std::array<double, 4> quaternion(const Vec3& c0, const Vec3& c1, const Vec3& c2) {
  const double trace = c0[0] + c1[1] + c2[2];
  std::array<double, 4> q{};
  if (trace >= std::max({c0[0], c1[1], c2[2]})) {
    q = {1 + trace, c1[2] - c2[1], c2[0] - c0[2], c0[1] - c1[0]};
  } else if (c0[0] >= c1[1] && c0[0] >= c2[2]) {
    q = {c1[2] - c2[1], 1 + 2 * c0[0] - trace, c0[1] + c1[0], c0[2] + c2[0]};
  } else if (c1[1] >= c2[2]) {
    q = {c2[0] - c0[2], c0[1] + c1[0], 1 + 2 * c1[1] - trace, c1[2] + c2[1]};
  } else {
    q = {c0[1] - c1[0], c0[2] + c2[0], c1[2] + c2[1], 1 + 2 * c2[2] - trace};
  }
  const double length = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
  const double factor = (q[0] < 0 ? -1 : 1) / length;
  for (double& v : q) v *= factor;
  return q;
}

}  // namespace

Quadratic fit_transfer(const Rpc& reference, const Rpc& source, const LocalFrame& frame,
                       const Window& window, const HeightRange& z_range) {
  return fit_over("fit_transfer", frame, window, z_range,
                  [&](const Pixel& pixel, double h) -> Sample {
                    const Pixel seen = source.project(reference.localize(pixel, h));
                    return {{pixel.x, pixel.y, h - frame.h0}, {seen.x, seen.y}};
                  });
}

Quadratic fit_localisation(const Rpc& rpc, const LocalFrame& frame, const Window& window,
                           const HeightRange& z_range) {
  return fit_over("fit_localisation", frame, window, z_range,
                  [&](const Pixel& pixel, double h) -> Sample {
                    const Vec3 p = frame.local_from_geodetic(rpc.localize(pixel, h));
                    return {{pixel.x, pixel.y, p[2]}, {p[0], p[1]}};
                  });
}

Quadratic fit_projection(const Rpc& rpc, const LocalFrame& frame, const Window& window,
                         const HeightRange& z_range) {
  return fit_over("fit_projection", frame, window, z_range,
                  [&](const Pixel& pixel, double h) -> Sample {
                    return {frame.local_from_geodetic(rpc.localize(pixel, h)), {pixel.x, pixel.y}};
                  });
}

ViewGeometry view_geometry(const PixelJacobian& jacobian) {
  const Vec3 &a1 = jacobian[0], &a2 = jacobian[1];
  // Gram-Schmidt: A = K2 [r1; r2] with a lower triangular K2, r3 = r1 x r2 looks away from the
  // satellite.
  const Vec3 r1 = unit(a1);
  const double along = dot(a2, r1);
  const Vec3 across{a2[0] - along * r1[0], a2[1] - along * r1[1], a2[2] - along * r1[2]};
  const Vec3 r2 = unit(across);
  const Vec3 r3{r1[1] * r2[2] - r1[2] * r2[1], r1[2] * r2[0] - r1[0] * r2[2],
                r1[0] * r2[1] - r1[1] * r2[0]};
  if (!(r3[2] < 0)) {
    std::ostringstream text;
    text << "view_geometry: the viewing direction has an upward component " << r3[2]
         << ", expected a negative one; the image is mirrored or degenerate";
    throw Error(text.str());
  }
  // det K2 = |a1| |across|
  const double det = std::sqrt(dot(a1, a1) * dot(across, across));
  return {quaternion(r1, r2, r3), 1 / std::sqrt(det), {r3[0] / r3[2], r3[1] / r3[2], 1}};
}

}  // namespace satsurf::rpc

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/rpc/model.h"

#include "satsurf/core/error.h"

#include <algorithm>
#include <cmath>
#include <sstream>

#include <Eigen/QR>

namespace satsurf::rpc {
namespace {

using Cubic = std::array<double, 20>;

/// `rpc_monomials` and their derivatives.
struct Monomials {
  Cubic m, dP, dL, dH;

  Monomials(double P, double L, double H)
      : m(rpc_monomials(P, L, H)),
        dP{0,     0, 1,         0, L,     0,         H,     0, 2 * P,     0,
           L * H, 0, 2 * L * P, 0, L * L, 3 * P * P, H * H, 0, 2 * P * H, 0},
        dL{0,     1,         0,     0,     P,         H, 0, 2 * L,     0, 0,
           P * H, 3 * L * L, P * P, H * H, 2 * L * P, 0, 0, 2 * L * H, 0, 0},
        dH{0,     0, 0, 1,         0, L, P,         0,     0,     2 * H,
           P * L, 0, 0, 2 * L * H, 0, 0, 2 * P * H, L * L, P * P, 3 * H * H} {}
};

double dot(const Cubic& a, const Cubic& b) {
  double sum = 0;
  for (std::size_t i = 0; i < a.size(); ++i) sum += a[i] * b[i];
  return sum;
}

struct Normalised {
  double P, L, H;
  Normalised(const Rpc& r, const Geodetic& p)
      : P((p.lat - r.lat_off) / r.lat_scale),
        // The shorter way round, so that a scene may lie across the antimeridian.
        L(degrees_wrapped(p.lon - r.lon_off) / r.lon_scale),
        H((p.h - r.height_off) / r.height_scale) {}
};

struct Linearised {
  Pixel pixel;
  PixelJacobian jacobian;
};

Linearised linearise(const Rpc& r, const Geodetic& p) {
  const Normalised q(r, p);
  const Monomials m(q.P, q.L, q.H);
  Linearised out{};
  const auto row = [&](const Cubic& num, const Cubic& den, double scale) {
    const double D = dot(den, m.m), f = dot(num, m.m) / D;
    // f = N / D:  df/dq = (dN/dq - f dD/dq) / D
    const auto slope = [&](const Cubic& dm) {
      return scale * (dot(num, dm) - f * dot(den, dm)) / D;
    };
    const std::array<double, 3> j{slope(m.dL) / r.lon_scale, slope(m.dP) / r.lat_scale,
                                  slope(m.dH) / r.height_scale};
    return std::pair{scale * f, j};
  };
  const auto [x, jx] = row(r.samp_num, r.samp_den, r.samp_scale);
  const auto [y, jy] = row(r.line_num, r.line_den, r.line_scale);
  out.pixel = {x + r.samp_off, y + r.line_off};
  out.jacobian = {jx, jy};
  return out;
}

}  // namespace

Pixel Rpc::project(const Geodetic& p) const {
  const Normalised q(*this, p);
  const Cubic m = rpc_monomials(q.P, q.L, q.H);
  return {samp_scale * dot(samp_num, m) / dot(samp_den, m) + samp_off,
          line_scale * dot(line_num, m) / dot(line_den, m) + line_off};
}

PixelJacobian Rpc::jacobian(const Geodetic& p) const { return linearise(*this, p).jacobian; }

Geodetic Rpc::localize(const Pixel& pixel, double h) const {
  constexpr int kSteps = 4;            // three reach 1e-9 px from 13000 px away; one in reserve
  constexpr double kTolerance = 1e-3;  // px
  Geodetic p{lon_off, lat_off, h};
  for (int step = 0; step < kSteps; ++step) {
    const Linearised at = linearise(*this, p);
    const double dx = pixel.x - at.pixel.x, dy = pixel.y - at.pixel.y;
    const auto& [jx, jy] = at.jacobian;
    const double det = jx[0] * jy[1] - jx[1] * jy[0];
    p.lon += (jy[1] * dx - jx[1] * dy) / det;
    p.lat += (jx[0] * dy - jy[0] * dx) / det;
  }
  const Pixel back = project(p);
  const double residual = std::hypot(back.x - pixel.x, back.y - pixel.y);
  if (!(residual <= kTolerance)) {
    std::ostringstream text;
    text << "Rpc::localize: residual " << residual << " px after " << kSteps
         << " Newton steps for pixel (" << pixel.x << ", " << pixel.y << ") at height " << h
         << " m, expected at most " << kTolerance
         << " px; the pixel or the height may lie outside the camera's range";
    throw Error(text.str());
  }
  if (!(std::abs(p.lat) <= 90)) {  // a root of the polynomials, but no place
    std::ostringstream text;
    text << "Rpc::localize: latitude " << p.lat << " for pixel (" << pixel.x << ", " << pixel.y
         << ") at height " << h << " m, expected one within 90 degrees";
    throw Error(text.str());
  }
  p.lon = degrees_wrapped(p.lon);
  return p;
}

std::array<double, 2> Rpc::ray_slope(const Geodetic& p) const {
  // The pixel stays fixed along the ray:  J_(lon,lat) d(lon,lat)/dh + J_h = 0
  const auto [jx, jy] = jacobian(p);
  const double det = jx[0] * jy[1] - jx[1] * jy[0];
  return {-(jy[1] * jx[2] - jx[1] * jy[2]) / det, -(jx[0] * jy[2] - jy[0] * jx[2]) / det};
}

Rpc Rpc::cropped(double x0, double y0) const {
  Rpc r = *this;
  r.samp_off -= x0;
  r.line_off -= y0;
  return r;
}

namespace {

/// A numerator over some denominator that comes to the ratio of another pair, over the cube for which
/// the polynomials are normalised.
struct OverOther {
  Cubic num{};
  double most_off = 0;
};

OverOther over(const Cubic& den, const Cubic& other_num, const Cubic& other_den) {
  constexpr int kSteps = 4;  // from the middle to a side
  constexpr int kSide = 2 * kSteps + 1, kPoints = kSide * kSide * kSide;
  Eigen::MatrixXd A(kPoints, 20);
  Eigen::VectorXd wanted(kPoints);
  int k = 0;
  const auto at = [](int i) { return static_cast<double>(i - kSteps) / kSteps; };
  for (int i = 0; i < kSide; ++i)
    for (int j = 0; j < kSide; ++j)
      for (int h = 0; h < kSide; ++h, ++k) {
        const Cubic m = rpc_monomials(at(i), at(j), at(h));
        const double D = dot(den, m);
        for (std::size_t c = 0; c < m.size(); ++c) A(k, static_cast<Eigen::Index>(c)) = m[c] / D;
        wanted[k] = dot(other_num, m) / dot(other_den, m);
      }
  const Eigen::VectorXd c = A.colPivHouseholderQr().solve(wanted);
  OverOther out;
  for (std::size_t i = 0; i < out.num.size(); ++i) out.num[i] = c[static_cast<Eigen::Index>(i)];
  out.most_off = (A * c - wanted).cwiseAbs().maxCoeff();
  return out;
}

}  // namespace

Rpc Rpc::corrected(const Pixel& shift, const ShiftSlope& slope) const {
  constexpr double kTolerance = 0.01;  // px
  Rpc r = *this;
  const Pixel in_the_middle = slope.in({samp_off, line_off});
  r.samp_off += shift.x + in_the_middle.x;
  r.line_off += shift.y + in_the_middle.y;
  if (slope.empty()) return r;
  // x' = x + slope_xx scale_x (N_x / D_x) + slope_xy scale_y (N_y / D_y) + ..., all over D_x
  const OverOther line = over(samp_den, line_num, line_den),
                  samp = over(line_den, samp_num, samp_den);
  const auto& s = slope.per_pixel;
  const double x_from_y = s[0][1] * line_scale, y_from_x = s[1][0] * samp_scale,
               off =
                   std::max(std::abs(x_from_y) * line.most_off, std::abs(y_from_x) * samp.most_off);
  if (!(off <= kTolerance)) {
    std::ostringstream text;
    text << "Rpc::corrected: residual " << off << " px, expected at most " << kTolerance
         << " px; the denominators of the camera may have zeros";
    throw Error(text.str());
  }
  for (std::size_t i = 0; i < r.samp_num.size(); ++i) {
    r.samp_num[i] += s[0][0] * samp_num[i] + x_from_y / samp_scale * line.num[i];
    r.line_num[i] += s[1][1] * line_num[i] + y_from_x / line_scale * samp.num[i];
  }
  return r;
}

Rpc Rpc::resized(double factor) const {
  Rpc r = *this;
  r.samp_off = (samp_off + 0.5) * factor - 0.5;
  r.line_off = (line_off + 0.5) * factor - 0.5;
  r.samp_scale *= factor;
  r.line_scale *= factor;
  return r;
}

Rpc Rpc::turned(int quarters, Index width, Index height) const {
  if (quarters == 0) return *this;
  Rpc r = *this;
  r.samp_off = static_cast<double>(height - 1) - line_off;
  r.samp_scale = line_scale;
  r.samp_num = line_num;
  for (double& c : r.samp_num) c = -c;
  r.samp_den = line_den;
  r.line_off = samp_off;
  r.line_scale = samp_scale;
  r.line_num = samp_num;
  r.line_den = samp_den;
  return r.turned(quarters - 1, height, width);
}

}  // namespace satsurf::rpc

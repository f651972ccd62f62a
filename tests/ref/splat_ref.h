// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/rng.h"
#include "satsurf/splat/rasterize.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>
#include <vector>

namespace satsurf::test {

/// What the rasteriser should draw, [kMaps + K][H][W] as colour 3, height, alpha, normal 3, aux K.
struct SplatReference {
  BasicTensor<double> maps, median;
  /// [H W] what is left of the light behind all surfels
  BasicTensor<double> transmittance;
  /// [H W] 1 where some decision was so close that rounding in float may turn it
  BasicTensor<double> doubtful;
};

/// Every pixel asks every surfel, in plain loops: no tiles, no boxes, no vectors.
template <class T>
SplatReference splat_reference(const splat::BasicSurfels<T>& s,
                               const splat::BasicProjection<T>& camera,
                               const splat::RasterOptions& options) {
  const Index P = s.means.dim(0), K = s.aux.empty() ? 0 : s.aux.dim(1);
  const Index H = options.height, W = options.width;
  struct Disc {
    double m[2], inverse[2][2], slope[2], z, opacity, normal[3];
    Index id;
  };
  std::vector<Disc> discs;
  for (Index p = 0; p < P; ++p) {
    const auto at = [&](const BasicVar<T>& v, Index n, Index i) {
      return static_cast<double>(v.value()[n * p + i]);
    };
    double q[4], r[3][3], a[2][3], length = 0;
    for (Index i = 0; i < 4; ++i) q[i] = at(s.quats, 4, i);
    for (const double c : q) length += c * c;
    for (double& c : q) c /= std::sqrt(length);
    // R v = v + 2 w (t x v) + 2 t x (t x v) with t = (x, y, z), column by column
    const double t[3] = {q[1], q[2], q[3]};
    for (int c = 0; c < 3; ++c) {
      const double v[3] = {c == 0 ? 1.0 : 0.0, c == 1 ? 1.0 : 0.0, c == 2 ? 1.0 : 0.0};
      const auto cross = [](const double* x, const double* y) {
        return std::array<double, 3>{x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2],
                                     x[0] * y[1] - x[1] * y[0]};
      };
      const auto once = cross(t, v), twice = cross(t, once.data());
      for (std::size_t i = 0; i < 3; ++i) r[i][c] = v[i] + 2 * q[0] * once[i] + 2 * twice[i];
    }
    for (int k = 0; k < 2; ++k)
      for (int c = 0; c < 3; ++c)
        a[k][c] = static_cast<double>(camera.jacobians[6 * p + 3 * k + c]);
    Disc d{};
    d.id = p;
    double j[2][2];
    for (int k = 0; k < 2; ++k) {
      d.m[k] = static_cast<double>(camera.pixels[2 * p + k]);
      for (int c = 0; c < 2; ++c) {
        j[k][c] = 0;
        for (int i = 0; i < 3; ++i) j[k][c] += a[k][i] * r[i][c] * at(s.scales, 2, c);
      }
      d.slope[k] = at(s.scales, 2, k) * r[2][k];
    }
    const double det = j[0][0] * j[1][1] - j[0][1] * j[1][0];
    d.inverse[0][0] = j[1][1] / det, d.inverse[0][1] = -j[0][1] / det;
    d.inverse[1][0] = -j[1][0] / det, d.inverse[1][1] = j[0][0] / det;
    d.z = at(s.means, 3, 2);
    d.opacity = at(s.opacity, 1, 0);
    const double sight[3] = {a[0][1] * a[1][2] - a[0][2] * a[1][1],
                             a[0][2] * a[1][0] - a[0][0] * a[1][2],
                             a[0][0] * a[1][1] - a[0][1] * a[1][0]};
    double facing = 0;
    for (int i = 0; i < 3; ++i) facing += r[i][2] * (sight[2] > 0 ? sight[i] : -sight[i]);
    for (int i = 0; i < 3; ++i) d.normal[i] = facing > 0 ? r[i][2] : -r[i][2];

    bool finite = std::isfinite(det) && std::isfinite(d.m[0]) && std::isfinite(d.m[1]) &&
                  std::isfinite(d.opacity) && std::isfinite(1 / det);
    for (Index i = 0; i < 3; ++i)
      finite = finite && std::isfinite(at(s.means, 3, i)) && std::isfinite(at(s.colours, 3, i));
    for (Index k = 0; k < K; ++k) finite = finite && std::isfinite(at(s.aux, K, k));
    if (finite && std::abs(det) >= 1e-8 && d.opacity > (options.smooth_cutoffs ? 0 : 1.0 / 255))
      discs.push_back(d);
  }
  std::stable_sort(discs.begin(), discs.end(),
                   [](const Disc& x, const Disc& y) { return x.z > y.z; });

  SplatReference out{BasicTensor<double>({8 + K, H, W}),
                     BasicTensor<double>({H, W}, std::numeric_limits<double>::quiet_NaN()),
                     BasicTensor<double>({H, W}, 1.0), BasicTensor<double>({H, W})};
  const auto near = [](double x, double limit, double band) {
    return std::abs(x - limit) < band * limit;
  };
  for (Index y = 0; y < H; ++y)
    for (Index x = 0; x < W; ++x) {
      const Index pixel = y * W + x;
      const auto map = [&](Index c) -> double& { return out.maps[c * H * W + pixel]; };
      double& left = out.transmittance[pixel];
      double& doubtful = out.doubtful[pixel];
      for (const Disc& d : discs) {
        const double dx = static_cast<double>(x) - d.m[0], dy = static_cast<double>(y) - d.m[1];
        const double u = d.inverse[0][0] * dx + d.inverse[0][1] * dy,
                     v = d.inverse[1][0] * dx + d.inverse[1][1] * dy;
        const double disc = u * u + v * v, filter = 2 * (dx * dx + dy * dy);
        const double rho = std::min(disc, filter);
        double alpha = d.opacity * std::exp(-rho / 2);
        if (!options.smooth_cutoffs) {
          if (near(alpha, 1.0 / 255, 1e-3)) doubtful = 1;
          alpha = std::min(alpha, 0.99);
          if (alpha < 1.0 / 255) continue;
          if (near(left * (1 - alpha), 1e-4, 1e-3)) doubtful = 1;
          if (left * (1 - alpha) < 1e-4) break;
        }
        if (near(disc, filter, 1e-3)) doubtful = 1;
        const double w = left * alpha,
                     h = d.z + (disc <= filter ? u * d.slope[0] + v * d.slope[1] : 0);
        for (Index c = 0; c < 3; ++c) {
          map(c) += w * static_cast<double>(s.colours.value()[3 * d.id + c]);
          map(5 + c) += w * d.normal[c];
        }
        map(3) += w * h;
        map(4) += w;
        for (Index k = 0; k < K; ++k)
          map(8 + k) += w * static_cast<double>(s.aux.value()[K * d.id + k]);
        if (near(left * (1 - alpha), 0.5, 1e-3)) doubtful = 1;
        if (left > 0.5 && left * (1 - alpha) <= 0.5) out.median[pixel] = h;
        left *= 1 - alpha;
      }
      for (Index c = 0; c < 3; ++c) map(c) += left * options.background[c];
      map(3) /= std::max(map(4), 1e-6);
    }
  return out;
}

/// An oblique camera of about 0.5 m per pixel that maps the frame's origin to the pixel (x0, y0).
inline Quadratic oblique_camera(double x0, double y0) {
  Quadratic q;
  q.coeff[0] = {x0, 1.9, 0.2, 0.5};
  q.coeff[1] = {y0, 0.15, -2.0, -0.7};
  return q;
}

/// Surfels that land in an image of the oblique camera at (0, 0): wide and small ones, of all
/// attitudes.
template <class T>
splat::BasicSurfels<T> random_surfels(Index P, Index K, Index height, Index width,
                                      std::uint64_t seed) {
  Rng rng(seed);
  BasicTensor<double> means({P, 3}), quats({P, 4}), scales({P, 2}), opacity({P}), colours({P, 3}),
      aux({P, K});
  for (Index p = 0; p < P; ++p) {
    means[3 * p] = rng.uniform(-1, 0.5 * static_cast<double>(width) + 1);
    means[3 * p + 1] = -rng.uniform(-1, 0.5 * static_cast<double>(height) + 1);
    means[3 * p + 2] = rng.uniform(-2, 2);
    for (Index i = 0; i < 4; ++i) quats[4 * p + i] = rng.normal() + (i == 0 ? 1 : 0);
    for (Index i = 0; i < 2; ++i) scales[2 * p + i] = 0.1 + 2 * rng.uniform() * rng.uniform();
    opacity[p] = rng.uniform(0.05, 0.98);
    for (Index i = 0; i < 3; ++i) colours[3 * p + i] = rng.uniform();
    for (Index i = 0; i < K; ++i) aux[K * p + i] = rng.normal();
  }
  const auto var = [](const BasicTensor<double>& t) {
    return BasicVar<T>(t.template cast<T>(), true);
  };
  return {var(means),   var(quats),   var(scales),
          var(opacity), var(colours), K > 0 ? var(aux) : BasicVar<T>()};
}

}  // namespace satsurf::test

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/reconstruct/cell_slopes.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace satsurf::reconstruct {
namespace {

constexpr Index kGrain = 16;  // rows of one piece of work

/// m per cell.
struct Slope {
  double east = 0, north = 0;
};

/// Heights of the cells around one above its own, rows from the north; NaN where unknown.
using Around = std::array<std::array<double, 3>, 3>;

Around around(const Tensor& z, Index row, Index column) {
  const Index H = z.dim(0), W = z.dim(1);
  const double middle = static_cast<double>(z[row * W + column]);
  Around out;
  for (Index v = 0; v < 3; ++v)
    for (Index u = 0; u < 3; ++u) {
      const Index y = row + v - 1, x = column + u - 1;
      const bool inside = y >= 0 && x >= 0 && y < H && x < W;
      out[static_cast<std::size_t>(v)][static_cast<std::size_t>(u)] =
          inside ? static_cast<double>(z[y * W + x]) - middle : std::nan("");
    }
  return out;
}

/// The difference that is the smaller one of two, of which any may be unknown.
double smaller(double before, double after) {
  if (std::isnan(before)) return std::isnan(after) ? 0 : after;
  return std::abs(after) < std::abs(before) ? after : before;  // also where `after` is unknown
}

/// The least-squares plane, free in height, through the cells that lie in another one; that other
/// one where they are all in a line.
Slope fitted(const Around& z, const Slope& guess, double tolerance) {
  double n = 0, x = 0, y = 0, h = 0, xx = 0, xy = 0, yy = 0, xh = 0, yh = 0;
  for (std::size_t v = 0; v < 3; ++v)
    for (std::size_t u = 0; u < 3; ++u) {
      const double east = static_cast<double>(u) - 1, north = 1 - static_cast<double>(v),
                   up = z[v][u];
      if (!(std::abs(up - guess.east * east - guess.north * north) <= tolerance)) continue;
      n += 1, x += east, y += north, h += up;
      xx += east * east, xy += east * north, yy += north * north;
      xh += east * up, yh += north * up;
    }
  const double a = xx - x * x / n, b = xy - x * y / n, c = yy - y * y / n, p = xh - x * h / n,
               q = yh - y * h / n, determinant = a * c - b * b;
  if (!(determinant > 1e-3)) return guess;
  return {(p * c - q * b) / determinant, (q * a - p * b) / determinant};
}

}  // namespace

double plane_tolerance(double step) { return std::clamp(step, 0.3, 1.0); }

Tensor cell_slopes(const scene::HeightField& surface) {
  Dims dim("cell_slopes");
  dim.match("surface.z", surface.z, "H W");
  const Index H = dim["H"], W = dim["W"];
  const double tolerance = plane_tolerance(surface.step);
  Tensor out({H, W, 2});
  for_range(H, kGrain, [&](Index begin, Index end) {
    for (Index i = begin * W; i < end * W; ++i) {
      if (!std::isfinite(surface.z[i])) continue;
      const Around z = around(surface.z, i / W, i % W);
      Slope slope{smaller(-z[1][0], z[1][2]), smaller(-z[2][1], z[0][1])};
      for (int pass = 0; pass < 2; ++pass) slope = fitted(z, slope, tolerance);
      out[2 * i] = static_cast<float>(slope.east / surface.step);
      out[2 * i + 1] = static_cast<float>(slope.north / surface.step);
    }
  });
  return out;
}

}  // namespace satsurf::reconstruct

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/shape.h"

#include <array>
#include <cmath>

namespace satsurf::rpc {

/// A longitude as one from -180 degrees on, below 180.
inline double degrees_wrapped(double lon) {
  return lon - 360.0 * std::floor((lon + 180.0) / 360.0);
}

/// The 20 cubic monomials of an RPC's normalised latitude P, longitude L and height H, in the order of
/// RPC00B (RPC00A has another).
/// Source: STDI-0002, volume 1, appendix E.
inline std::array<double, 20> rpc_monomials(double P, double L, double H) {
  return {1,         L,         P,         H,         L * P,     L * H,     P * H,
          L * L,     P * P,     H * H,     P * L * H, L * L * L, L * P * P, L * H * H,
          L * L * P, P * P * P, P * H * H, L * L * H, P * P * H, H * H * H};
}

/// Position on the ellipsoid: degrees and metres above WGS84, always in this order.
struct Geodetic {
  double lon = 0, lat = 0, h = 0;
};

/// Image position; (0, 0) is the centre of the first pixel, x right (sample), y down (line).
struct Pixel {
  double x = 0, y = 0;
};

/// Derivatives of a pixel, [x, y][coordinate of a point].
using PixelJacobian = std::array<std::array<double, 3>, 2>;

/// What a shift of an image changes by within it: `shift + per_pixel (p - at)` in pixel p.
struct ShiftSlope {
  Pixel at;                                          ///< where it does not change the shift
  std::array<std::array<double, 2>, 2> per_pixel{};  ///< [of x, of y][right, down]

  bool empty() const { return per_pixel == decltype(per_pixel){}; }
  /// What is added to a shift in a pixel, px.
  Pixel in(const Pixel& p) const {
    const double x = p.x - at.x, y = p.y - at.y;
    return {per_pixel[0][0] * x + per_pixel[0][1] * y, per_pixel[1][0] * x + per_pixel[1][1] * y};
  }
  /// The same for the image that begins at pixel (x0, y0), and for the one resized by `factor`, whose
  /// shift is the smaller by that factor.
  ShiftSlope cropped(double x0, double y0) const { return {{at.x - x0, at.y - y0}, per_pixel}; }
  ShiftSlope resized(double factor) const {
    return {{(at.x + 0.5) * factor - 0.5, (at.y + 0.5) * factor - 0.5}, per_pixel};
  }
};

/// Whether a position lies in an image: on the area of one of its width x height pixels, of which
/// each has its left and upper edge but not the others.
inline bool inside_image(const Pixel& p, Index width, Index height) {
  return p.x >= -0.5 && p.y >= -0.5 && p.x < static_cast<double>(width) - 0.5 &&
         p.y < static_cast<double>(height) - 0.5;
}

/// Rational polynomial camera, RPC00B:
///   samp = samp_scale (SN . m) / (SD . m) + samp_off,   likewise line
/// with m the 20 cubic monomials of the normalised latitude P, longitude L and height H.
/// A plain value: copying is cheap, nothing here does I/O.
/// Source: STDI-0002, appendix E (RPC00B).
struct Rpc {
  double line_off = 0, samp_off = 0, lat_off = 0, lon_off = 0, height_off = 0;
  double line_scale = 1, samp_scale = 1, lat_scale = 1, lon_scale = 1, height_scale = 1;
  std::array<double, 20> line_num{}, line_den{}, samp_num{}, samp_den{};

  /// Where a point falls in the image, px.
  Pixel project(const Geodetic& p) const;
  /// Derivatives of `project`, [row x, y][lon, lat, h]: px per degree, px per degree, px per m.
  PixelJacobian jacobian(const Geodetic& p) const;
  /// The point at height h that projects to `pixel`: Newton, four fixed steps from the centre of
  /// the RPC.
  /// pixel   px
  /// h       m above the ellipsoid
  /// throws  Error naming pixel and height if the residual stays above 1e-3 px, or beyond a pole
  Geodetic localize(const Pixel& pixel, double h) const;
  /// d(lon, lat)/dh along the viewing ray through `p`, degrees per m.
  std::array<double, 2> ray_slope(const Geodetic& p) const;
  /// The camera of the image that begins at pixel (x0, y0) of this one.
  Rpc cropped(double x0, double y0) const;
  /// The camera of the image resized by `factor` (0.5 halves it):
  /// pixel centres move to (x + 0.5) factor - 0.5.
  Rpc resized(double factor) const;
  /// The camera of the image turned clockwise: one quarter moves pixel (x, y) to
  /// (height - 1 - y, x).
  /// quarters       0 to 3
  /// width, height  of the image before, px
  Rpc turned(int quarters, Index width, Index height) const;

  /// The camera that sees every point further on by a shift that changes within the image. Without
  /// a slope it is exact, else within 0.01 px.
  /// throws  Error naming the residual where no rational polynomial of the denominators is as near
  Rpc corrected(const Pixel& shift, const ShiftSlope& slope = {}) const;

  friend bool operator==(const Rpc&, const Rpc&) = default;
};

}  // namespace satsurf::rpc

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/shape.h"

#include <array>

namespace satsurf {

/// Two quadratics in one coordinate.
struct QuadraticLine {
  double offset = 0, scale = 1;                  ///< of the coordinate
  std::array<std::array<double, 3>, 2> coeff{};  ///< of 1, q and qq with q = (z - offset) / scale

  std::array<double, 2> operator()(double z) const {
    const double c = (z - offset) / scale;
    return {coeff[0][0] + c * (coeff[0][1] + c * coeff[0][2]),
            coeff[1][0] + c * (coeff[1][1] + c * coeff[1][2])};
  }
};

/// A map from three coordinates to two by one full quadratic each, in normalised inputs: the local
/// stand-in for an RPC camera inside the kernels (fitted in rpc/fit.h, stored in double, evaluated
/// in float or double).
///   q = (p - offset) / scale,   out_k = sum_m coeff[k][m] * monomial_m(q)
///   monomials: 1, x, y, z, xx, xy, xz, yy, yz, zz
struct Quadratic {
  std::array<double, 3> offset{0, 0, 0};
  std::array<double, 3> scale{1, 1, 1};
  std::array<std::array<double, 10>, 2> coeff{};
  double rms = 0;  ///< fit residual in units of the output (px or m)
  double max = 0;  ///< largest residual on the fitting grid, same unit

  /// The outputs at one point.
  std::array<double, 2> operator()(double x, double y, double z) const;
  /// The outputs along z where x and y stay as they are; equal but for rounding.
  QuadraticLine along_z(double x, double y) const;
  /// Derivatives at one point, [out][in], in units of output per unit of input.
  std::array<std::array<double, 3>, 2> jacobian(double x, double y, double z) const;
};

/// The same map for downsampled pixel grids, with pixel centres at x_s = (x + 0.5) / s - 0.5.
/// map         from pixels x, y and a height to pixels
/// in_stride   s of the inputs x, y; 1 leaves them as they are
/// out_stride  s of the outputs; 1 leaves them as they are
Quadratic rescale_pixels(const Quadratic& map, double in_stride, double out_stride);

/// The same map after moving the origins of the pixels: inputs become p - in, outputs out_k - out.
/// map  from pixels x, y and a height to pixels
/// in   new origin of the input pixels x, y
/// out  new origin of the output pixels
Quadratic shift_pixels(const Quadratic& map, std::array<double, 2> in, std::array<double, 2> out);

}  // namespace satsurf

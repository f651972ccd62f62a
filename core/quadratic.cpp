// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/quadratic.h"

namespace satsurf {

std::array<double, 2> Quadratic::operator()(double x, double y, double z) const {
  const double a = (x - offset[0]) / scale[0], b = (y - offset[1]) / scale[1],
               c = (z - offset[2]) / scale[2];
  std::array<double, 2> out{};
  for (std::size_t k = 0; k < 2; ++k) {
    const auto& q = coeff[k];
    out[k] = q[0] + a * (q[1] + q[4] * a + q[5] * b + q[6] * c) + b * (q[2] + q[7] * b + q[8] * c) +
             c * (q[3] + q[9] * c);
  }
  return out;
}

QuadraticLine Quadratic::along_z(double x, double y) const {
  const double a = (x - offset[0]) / scale[0], b = (y - offset[1]) / scale[1];
  QuadraticLine out{offset[2], scale[2], {}};
  for (std::size_t k = 0; k < 2; ++k) {
    const auto& q = coeff[k];
    out.coeff[k] = {q[0] + a * (q[1] + q[4] * a + q[5] * b) + b * (q[2] + q[7] * b),
                    q[3] + a * q[6] + b * q[8], q[9]};
  }
  return out;
}

std::array<std::array<double, 3>, 2> Quadratic::jacobian(double x, double y, double z) const {
  const double a = (x - offset[0]) / scale[0], b = (y - offset[1]) / scale[1],
               c = (z - offset[2]) / scale[2];
  std::array<std::array<double, 3>, 2> j{};
  for (std::size_t k = 0; k < 2; ++k) {
    const auto& q = coeff[k];
    j[k] = {(q[1] + 2 * q[4] * a + q[5] * b + q[6] * c) / scale[0],
            (q[2] + q[5] * a + 2 * q[7] * b + q[8] * c) / scale[1],
            (q[3] + q[6] * a + q[8] * b + 2 * q[9] * c) / scale[2]};
  }
  return j;
}

Quadratic rescale_pixels(const Quadratic& map, double in_stride, double out_stride) {
  Quadratic r = map;
  for (std::size_t k = 0; k < 2; ++k) {
    r.offset[k] = (map.offset[k] + 0.5) / in_stride - 0.5;
    r.scale[k] = map.scale[k] / in_stride;
    for (double& c : r.coeff[k]) c /= out_stride;
    r.coeff[k][0] += 0.5 / out_stride - 0.5;
  }
  r.rms /= out_stride;
  r.max /= out_stride;
  return r;
}

Quadratic shift_pixels(const Quadratic& map, std::array<double, 2> in, std::array<double, 2> out) {
  Quadratic r = map;
  for (std::size_t k = 0; k < 2; ++k) {
    r.offset[k] -= in[k];
    r.coeff[k][0] -= out[k];
  }
  return r;
}

}  // namespace satsurf

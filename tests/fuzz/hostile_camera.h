// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/rpc/model.h"

#include <array>
#include <cmath>
#include <vector>

#include "tests/fuzz/fuzz.h"

namespace satsurf::fuzz {

/// The number of a camera that the input changes: offsets, scales, then the four polynomials.
inline double& number_of(rpc::Rpc& r, std::size_t k) {
  double* const scalars[] = {&r.line_off,   &r.samp_off,    &r.lat_off,    &r.lon_off,
                             &r.height_off, &r.line_scale,  &r.samp_scale, &r.lat_scale,
                             &r.lon_scale,  &r.height_scale};
  std::array<double, 20>* const lists[] = {&r.line_num, &r.line_den, &r.samp_num, &r.samp_den};
  k %= 90;
  return k < 10 ? *scalars[k] : (*lists[(k - 10) / 20])[(k - 10) % 20];
}

/// Changes cameras one number at a time, each change two bytes and mostly eight of a double:
/// the number itself, a factor, a summand, or one of the values that nobody means.
inline void spoil(std::vector<rpc::Rpc>& cameras, Bytes& in) {
  constexpr double kNobody[] = {0,     -0.0,   NAN,    INFINITY, -INFINITY,
                                1e300, -1e300, 1e-300, 1e9,      -1e9};
  for (int changes = 0; changes < 64 && !in.empty(); ++changes) {
    const auto which = in.take<std::uint8_t>(), how = in.take<std::uint8_t>();
    double& number = number_of(cameras[how / 4 % cameras.size()], which);
    switch (how % 4) {
      case 0:
        number = in.take<double>();
        break;
      case 1:
        number *= in.take<double>();
        break;
      case 2:
        number += in.take<double>();
        break;
      default:
        number = kNobody[in.take<std::uint8_t>() % std::size(kNobody)];
    }
  }
}

}  // namespace satsurf::fuzz

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/rpc/height_range.h"
#include "satsurf/rpc/model.h"

#include <string>

namespace satsurf::rpc {

/// Refuses what is no camera, whether it comes from a file or from a program: numbers that are not finite, scales of zero,
/// places that are not on the Earth, polynomials of zeros. They would only surface as NaN much later.
/// where   begins the error texts
/// throws  IoError naming the number, as the file formats do
void check_camera(const Rpc& rpc, const std::string& where);

/// Whether a camera could be made for such heights above the ellipsoid: within 1000 km of it.
inline bool on_earth(const HeightRange& range) {
  constexpr double kMost = 1e6;  // m
  return range.low >= -kMost && range.low <= kMost && range.high >= -kMost && range.high <= kMost;
}

}  // namespace satsurf::rpc

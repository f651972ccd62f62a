// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/rng.h"

#include <cmath>

namespace satsurf::scene::simulate {

inline float draw(Rng& rng, double low, double high) {
  return static_cast<float>(rng.uniform(low, high));
}

/// Evenly spread over the logarithm.
inline double log_uniform(Rng& rng, double low, double high) {
  return low * std::pow(high / low, rng.uniform());
}

}  // namespace satsurf::scene::simulate

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/fields.h"
#include "satsurf/core/tensor.h"

#include <array>

namespace satsurf::train {

/// Which loss learns from which pixels.
enum class Routing {
  none,  ///< both from all of them
  cbrl   ///< geometry from the doubtful ones, appearance from the confident ones
};

}  // namespace satsurf::train

template <>
struct satsurf::EnumNames<satsurf::train::Routing> {
  static constexpr std::array names{"none", "cbrl"};
};

namespace satsurf::train {

struct RoutingOptions {
  Routing routing = Routing::cbrl;
  double threshold = 0.2;  ///< of the confidence, in [0, 1]
  bool warmup = false;     ///< appearance learns from all valid pixels, as if all were confident
};

/// Which pixels' terms each loss sums, 0 or 1. Routed without warm-up, every valid pixel is in
/// exactly one of them.
struct RoutingMasks {
  Tensor geometry, appearance;
};

/// Confidence-based routing of the losses: appearance where the confidence exceeds the threshold,
/// geometry elsewhere, also on the threshold and where the confidence is NaN. Average the masked
/// losses over all valid pixels (`masked_mean`), or the masks only choose among pixels and do not
/// weigh the losses against each other.
/// confidence  any shape, in [0, 1]
/// valid       its shape, 1 where a pixel counts and 0 where not, or an empty tensor for ones
/// throws      ShapeError, ConfigError
RoutingMasks route_losses(const Tensor& confidence, const Tensor& valid,
                          const RoutingOptions& options);

}  // namespace satsurf::train

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/tensor.h"

namespace satsurf::train {

/// Which loss learns from which pixels.
enum class Routing {
  none,  ///< both from all of them
  cbrl   ///< geometry from the doubtful ones, appearance from the confident ones
};

struct RoutingOptions {
  Routing routing = Routing::cbrl;
  double threshold = 0.2;  ///< of the confidence, in [0, 1]
  /// Compares (C - 1/D) / (1 - 1/D), which is 0 for equal probabilities and 1 for a certain height
  /// at every stage; else C itself, which is never below 1/D.
  bool floor_normalised = true;
  bool warmup = false;  ///< appearance learns from all valid pixels, as if all were confident
};

/// Which pixels each loss learns from, 0 or 1. Routed without warm-up, every valid pixel is in
/// exactly one of them.
struct RoutingMasks {
  Tensor geometry, appearance;
};

/// Confidence-based routing of the losses: appearance where the confidence exceeds the threshold,
/// geometry elsewhere, also on the threshold and where the confidence is NaN. Average the masked
/// losses over all valid pixels (`masked_mean`), or the masks only choose among pixels and do not
/// weigh the losses against each other.
/// confidence  any shape, the largest of D probabilities
/// valid       its shape, 1 where a pixel counts and 0 where not, or an empty tensor for ones
/// hypotheses  D, at least 2
/// throws      ShapeError, ConfigError
RoutingMasks route_losses(const Tensor& confidence, const Tensor& valid, Index hypotheses,
                          const RoutingOptions& options);

}  // namespace satsurf::train

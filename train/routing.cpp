// SPDX-License-Identifier: Apache-2.0
#include "satsurf/train/routing.h"

#include "satsurf/core/parallel.h"

#include <string>

namespace satsurf::train {
namespace {

constexpr Index kGrain = 1 << 15;

}  // namespace

RoutingMasks route_losses(const Tensor& confidence, const Tensor& valid,
                          const RoutingOptions& options) {
  if (!valid.empty() && valid.shape() != confidence.shape())
    throw ShapeError("route_losses: valid has shape " + valid.shape().str() + ", expected " +
                     confidence.shape().str() + " from confidence");
  if (!(options.threshold >= 0 && options.threshold <= 1))
    throw ConfigError("route_losses: threshold is " + std::to_string(options.threshold) +
                      ", expected 0 to 1");
  const auto least = static_cast<float>(options.threshold);
  const bool all = options.routing == Routing::none;

  RoutingMasks masks{Tensor::uninitialised(confidence.shape()),
                     Tensor::uninitialised(confidence.shape())};
  for_range(confidence.count(), kGrain, [&](Index begin, Index end) {
    for (Index i = begin; i < end; ++i) {
      const bool counts = valid.empty() || valid[i] != 0, confident = confidence[i] > least;
      masks.geometry[i] = counts && (all || !confident) ? 1.F : 0.F;
      masks.appearance[i] = counts && (all || options.warmup || confident) ? 1.F : 0.F;
    }
  });
  return masks;
}

}  // namespace satsurf::train

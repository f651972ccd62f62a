// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/input.h"
#include "satsurf/scene/scene.h"

#include <optional>
#include <vector>

namespace satsurf::scene {

/// A square window of every chosen view around one ground point, ready for the network.
struct Crop {
  nn::NetworkInput input;
  std::optional<nn::PosedImage> target;  ///< the view to be rendered, not among the sources
  /// True heights of source views, [stage][view] -> [h w], local z in m, NaN where unknown.
  /// Empty without truth.
  std::vector<std::vector<Tensor>> source_truth;
  Tensor target_truth;  ///< [H W], or empty
};

/// Cuts windows of the views around one ground point. Pixels outside an image are invalid.
/// sources        views the network is given, by index
/// target         the view to be rendered, if there is one
/// x, y, z        ground point in the middle of every window, local m
/// size           side of the windows, px, a multiple of the network's
/// z_low, z_high  height range of the crop, local m
/// with_truth     fill the true heights in, where the scene has them
Crop make_crop(const Scene& scene, const std::vector<Index>& sources, std::optional<Index> target,
               double x, double y, double z, Index size, double z_low, double z_high,
               bool with_truth);

}  // namespace satsurf::scene

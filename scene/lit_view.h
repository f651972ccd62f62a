// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/input.h"

#include <array>
#include <optional>

namespace satsurf::scene {

/// A view and its light.
struct LitView {
  nn::PosedImage image;  ///< whole, with its camera in the frame of the surface
  /// Metres east and north towards the sun per metre of height; lit everywhere without.
  std::optional<std::array<double, 2>> to_sun{};
};

}  // namespace satsurf::scene

// SPDX-License-Identifier: Apache-2.0
#pragma once

namespace satsurf::scene {

/// Codes of DFC2019's class rasters, which the simulator writes too.
inline constexpr float kGroundClass = 2, kTreeClass = 5, kBuildingClass = 6, kWaterClass = 9;

}  // namespace satsurf::scene

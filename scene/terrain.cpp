// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/terrain.h"

#include "satsurf/core/error.h"

#include <cstdio>

namespace satsurf::scene {

TerrainRange terrain_range(const rpc::Terrain& terrain, const rpc::UtmZone& zone,
                           const std::array<double, 4>& ground, double least) {
  constexpr double kLowest = -700, kHighest = 9000;  // m above the ellipsoid, of dry land
  const std::string where = terrain.path().string() + ": ";
  rpc::TerrainHeights found;
  try {
    found = terrain.over(zone, ground);
  } catch (const Error& e) {
    return {std::nullopt, where + e.what()};
  }
  char text[160];
  if (found.covered < least || !(found.covered > 0)) {
    std::snprintf(text, sizeof text,
                  "it knows %.0f %% of the images' ground, expected %.0f %% or more",
                  100 * found.covered, 100 * kTerrainKnown);
    return {std::nullopt, where + text};
  }
  if (found.heights.low < kLowest || found.heights.high > kHighest) {
    std::snprintf(text, sizeof text,
                  "heights from %.0f to %.0f m, expected those of terrain, %.0f to %.0f m; does it "
                  "declare its nodata?",
                  found.heights.low, found.heights.high, kLowest, kHighest);
    return {std::nullopt, where + text};
  }
  return {rpc::HeightRange{found.heights.low - kBelowTerrain, found.heights.high + kAboveTerrain},
          ""};
}

}  // namespace satsurf::scene

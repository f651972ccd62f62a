// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/rpc/frame.h"
#include "satsurf/rpc/ground_raster.h"

#include <array>
#include <optional>
#include <string>

namespace satsurf::scene {

/// What the surface may be below and above a model of the terrain, m: errors and pits, trees and all
/// but the tallest buildings.
inline constexpr double kBelowTerrain = 20, kAboveTerrain = 80;

/// Heights to search by a model of the terrain.
struct TerrainRange {
  std::optional<rpc::HeightRange>
      height_range;     ///< m above the ellipsoid; none where it is no help
  std::string trouble;  ///< why, in words
};

/// Share of the ground that a model of the terrain has to know.
inline constexpr double kTerrainKnown = 0.9;

/// The heights of the terrain over some ground with these margins. It is no help where it knows too
/// little of the ground, or says what no terrain is.
/// zone    of the ground
/// ground  least easting and northing, then the largest, m
/// least   share of it to know
TerrainRange terrain_range(const rpc::Terrain& terrain, const rpc::UtmZone& zone,
                           const std::array<double, 4>& ground, double least = kTerrainKnown);

}  // namespace satsurf::scene

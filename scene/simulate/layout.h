// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/scene/simulate/city.h"

#include <vector>

namespace satsurf::scene::simulate {

/// What covers a block.
enum class Ground : std::uint8_t { paved, parking, lawn, bare, crop, wild };

/// What lies between four streets; extents along the streets' axes, from kerb to kerb, m.
struct Block {
  float u0, u1, v0, v1;
  Ground ground = Ground::lawn;
  Colour colour{};
  float row_period = 1;  ///< of crop rows or parking stalls, m
  bool rows_along_u = true;
  std::uint32_t seed = 0;
};

/// Two families of straight streets, at right angles, about the centre of the field.
struct Streets {
  float cos = 1, sin = 0;              ///< direction of the first axis, u
  float half_width = 4, pavement = 2;  ///< m
  Colour colour{};
  bool marked = true;
  std::vector<float> u_lines, v_lines;  ///< positions of the street axes, ascending, m

  float u_of(float x, float y) const { return x * cos + y * sin; }
  float v_of(float x, float y) const { return y * cos - x * sin; }
};

/// Everything there is in a scene, before it is painted into columns.
struct Layout {
  CityPlan plan;
  Tensor terrain;  ///< [H W] local height of the bare ground, m
  Tensor shore;    ///< [H W] distance from the water, m, negative in it; empty without water
  Tensor lane;     ///< [H W] distance from the axis of the nearest winding lane, m; empty without
  float water_height = 0;        ///< local height, m
  float lane_half_width = 2.5f;  ///< m
  Streets streets;
  std::vector<Block> blocks;  ///< row by row of v, u_lines.size() - 1 in a row
  std::vector<Part> parts;
  std::vector<Tree> trees;
  float deciduous = 0.5f;  ///< share of the trees that lose their leaves in winter
  std::vector<Car> cars, visitors;

  float half_side() const {
    return 0.5f * static_cast<float>(plan.step * static_cast<double>(plan.size));
  }
  /// Value of a grid under a point in m from the centre; the nearest cell's beyond the edge.
  float at(const Tensor& grid, float x, float y) const;
};

/// Relief, shore and lanes.
void shape_ground(Layout& layout, const Rng& rng);
/// Streets, blocks and what stands on them.
void furnish(Layout& layout, const Rng& rng);
/// Adds a building with the plan (u0..u1) x (v0..v1) along the streets, unless water is in the way.
void add_building(Layout& layout, Rng& rng, float u0, float u1, float v0, float v1, float height);
/// Adds a house with a pitched roof around (u, v).
void add_house(Layout& layout, Rng& rng, float u, float v);
/// The colour of a car, of which most are white, black or grey.
Colour car_colour(Rng& rng);
/// Adds trees in clumps over the open ground.
/// density  in [0, 1]
/// spacing  of the places where a tree may stand, m
/// radius   of the largest crowns, m
void add_groves(Layout& layout, const Rng& rng, float density, float spacing, float radius);

}  // namespace satsurf::scene::simulate

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/rng.h"
#include "satsurf/scene/raycast.h"
#include "satsurf/scene/simulate/kind.h"

#include <algorithm>
#include <array>
#include <cstdint>
#include <string>
#include <vector>

namespace satsurf::scene::simulate {

using Colour = std::array<float, 3>;  ///< reflectance of red, green, blue

/// What a column is made of.
enum class Material : std::uint8_t {
  asphalt,
  concrete,
  grass,
  soil,
  rock,
  field,
  water,
  roof,
  tree,
  car
};

/// The form of a roof.
enum class Roof : std::uint8_t { flat, gable, hip, shed, barrel, sawtooth };
/// What a roof looks like from above.
enum class RoofPattern : std::uint8_t { plain, gravel, seams, tiles, sheets, panels };

/// An upright solid with a rectangular or elliptic plan. Buildings are made of one or several of
/// these.
struct Part {
  float x, y;        ///< centre, m from the centre of the field
  float cos, sin;    ///< direction of its first axis
  float a, b;        ///< half extents along its two axes, m
  float base, eave;  ///< local heights of the lowest ground under it and of the foot of its roof
  bool round = false;
  Roof roof = Roof::flat;
  float rise = 0;  ///< of the ridge above the eave, or of the parapet, m
  RoofPattern pattern = RoofPattern::plain;
  float pattern_period = 1;
  float texture = 1;  ///< factor on what makes a roof uneven in colour; 0 for none
  bool open = false;  ///< a roof on posts
  /// Of any plan: its walls face the cells in front of them, and the extents say nothing.
  bool free_form = false;
  Colour roof_colour{}, wall_colour{}, parapet_colour{};
  float storey = 3.2f, window_pitch = 3.0f, window_share = 0.5f;  ///< share 0: a blank wall
  bool ribbon_windows = false;
  std::uint32_t seed = 0;
};

/// A tree, or a boulder.
struct Tree {
  float x, y, radius, height, base;  ///< m; x and y from the centre of the field, base local
  Colour colour;
  std::uint32_t seed;                  ///< odd: a cone, else a dome
  Material material = Material::tree;  ///< or rock: a boulder
  bool deciduous = false;
};

/// A car or truck on the ground or on the uppermost deck of a car park; or a crane's mast.
struct Car {
  float x, y, cos, sin, length;  ///< m from the centre of the field; direction
  Colour colour{};
  float width = 1.8f, tall = 1.45f;  ///< m
  bool deck = false;
};

/// What a column of the height field looks like from above.
struct SurfaceCell {
  std::array<std::uint16_t, 3> albedo;    ///< reflectance * 65535
  std::uint16_t part = 0;                 ///< 1 + index of the part, 0 for none
  std::int16_t slope_x = 0, slope_y = 0;  ///< dz/dx, dz/dy * 4096
  Material material = Material::soil;
  std::uint8_t sky = 255;  ///< share of the sky that is visible * 255
  /// Of a tree: 0 at the crown's middle to 127 at its rim, + 128 if it sheds its leaves, + 256 times
  /// a number of the tree; of crops and lawns: a number of the block.
  std::uint16_t plant = 0;

  /// factor  on the reflectance, from texture
  void set_albedo(const Colour& reflectance, float factor) {
    for (std::size_t b = 0; b < 3; ++b) {
      albedo[b] = static_cast<std::uint16_t>(
          65535.0f * std::clamp(reflectance[b] * std::max(factor, 0.15f), 0.005f, 0.95f));
    }
  }
};

/// What a scene is to contain; heights are local, m.
struct CityPlan {
  SceneKind kind = SceneKind::city;
  double relief = 5;    ///< the ground stays within +-relief
  double tallest = 30;  ///< nothing rises higher above the ground
  bool water = false;
  bool dark = false;  ///< natural surfaces are dark here and there without a shadow
  /// Rock stands out of the ground, and gullies are cut into it; or it is an open pit.
  bool crags = false;
  double x0 = 0, y0 = 0, step = 0.25;  ///< grid of the height field
  Index size = 1024;                   ///< its rows and columns
};

/// A scene before any camera has seen it.
struct City {
  HeightField field;
  std::vector<SurfaceCell> cells;  ///< row by row as the field
  std::vector<Part> parts;
  /// What there is and how high where no tree is; empty if there are no trees.
  std::vector<SurfaceCell> floor;
  Tensor floor_z;
  /// Cars that may be there on one date and not on another; not in the field.
  std::vector<Car> visitors;
  /// Noise of about 1.3 m and of 14 to 90 m, deviation about 40, per cell: what differs between
  /// dates takes its pattern from it.
  std::vector<std::int8_t> fine, patch;
  double centre_x = 0, centre_y = 0;

  const SurfaceCell& cell(Index row, Index col) const {
    return cells[static_cast<std::size_t>(row * field.z.dim(1) + col)];
  }
};

/// Makes up a scene: a pure function of its arguments.
City make_city(const CityPlan& plan, const Rng& rng);

/// Classes of the DFC2019 truth for every cell: 2 ground, 5 trees, 6 building, 9 water.
/// returns  [H W]
Tensor classes_of(const City& city);

}  // namespace satsurf::scene::simulate

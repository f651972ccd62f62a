// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/rng.h"
#include "satsurf/scene/simulate/city.h"

namespace satsurf::scene::simulate {

/// What makes soil, rock and plants dark where the sun reaches them: lava and coal, wet and
/// weathered faces, layers of rock, burnt and peaty ground. Without such places everything dark is
/// a shadow or a roof.
class DarkGround {
 public:
  /// plan  gives grid and size
  DarkGround(const CityPlan& plan, const Rng& rng);

  /// Factor on the reflectance of a cell, 1 for what is not natural.
  /// cell       row by row
  /// z          local height, m
  /// steepness  of the ground, m per m
  float factor(Index cell, float z, float steepness, Material material) const;

 private:
  Tensor stains_, folds_;  // noise
  float rock_ = 1, soil_ = 1;
  float face_ = 1;                                    // of steep rock and soil
  float layer_ = 0, layer_height_ = 5, folding_ = 0;  // relative, m, m
  float stain_ = 1, stain_above_ = 0, stain_edge_ = 4;
  std::uint32_t seed_ = 0;
};

}  // namespace satsurf::scene::simulate

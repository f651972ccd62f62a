// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/scene/raycast.h"

namespace satsurf::reconstruct {

/// How far a height may be from a plane and still lie in it: a cell's side, from 0.3 to 1 m.
/// step     side of a cell, m
/// returns  m
double plane_tolerance(double step);

/// How a surface slopes in each of its cells: the least-squares plane through those of the cell and
/// its eight neighbours that lie in the plane found before, twice. The first one is guessed, along
/// each axis, from the smaller of the differences to the neighbours on either side, so that the rim
/// of a roof slopes as the roof does, and the ground before a wall as the ground.
/// returns  [H W 2] m per m towards east and north; 0 where the height or all around is unknown
/// throws   ShapeError
Tensor cell_slopes(const scene::HeightField& surface);

}  // namespace satsurf::reconstruct

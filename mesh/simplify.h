// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/tensor.h"
#include "satsurf/mesh/mesh.h"

namespace satsurf::mesh {

/// A mesh with fewer faces: all vertices in one cube of a regular grid become one, at their mean,
/// and faces that lose a corner go. The cubes are as small as the number allows, to a fiftieth of
/// their side. Made for looking at, not for measuring.
/// Source: Rossignac and Borrel 1993, vertex clustering.
/// most    faces that may be left, 1 or more; a mesh that has no more comes back as it is
/// throws  Error for a number below 1
Mesh simplified(const Mesh& mesh, Index most);

/// Heights on a grid as triangles between the centres of known cells, with normals.
/// z       [H W] m, NaN where unknown; row 0 is north
/// x0, y0  upper-left corner of the grid, m
/// step    cell, m
/// colour  [3 H W] in [0, 1], grey where it is not known; or empty for none
/// throws  Error where no three neighbours are known; ShapeError
Mesh mesh_from_heights(const Tensor& z, double x0, double y0, double step, const Tensor& colour);

}  // namespace satsurf::mesh

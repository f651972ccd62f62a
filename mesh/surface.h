// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/mesh/mesh.h"
#include "satsurf/mesh/tsdf.h"

#include <optional>
#include <span>

namespace satsurf::mesh {

/// The zero level of a signed distance as triangles with vertex normals, without colours. Cells
/// with an unknown corner carry no surface, so the mesh is open where nothing is known and closed
/// elsewhere. Connected pieces smaller than `least_area` are left out, but the largest always stays.
/// field       from `fuse`
/// least_area  m^2; 0 keeps everything
/// returns     the mesh; the same bits for any number of threads
/// throws      Error if nothing is left
Mesh extract_surface(const Tsdf& field, double least_area);

/// The surface that views of heights describe: `fuse`, `extract_surface` without pieces below
/// 20 x 20 voxels, `colour_vertices`.
/// throws  as these
Mesh mesh_from_views(std::span<const HeightImage> views, const FusionOptions& options);

/// Vertices and faces of the same, without normals and colours: what comparing shapes takes.
/// returns  nothing where the views have no height, or too few together for a surface
/// throws   as `fuse` for anything else
std::optional<Mesh> shape_from_views(std::span<const HeightImage> views,
                                     const FusionOptions& options);

}  // namespace satsurf::mesh

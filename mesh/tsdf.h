// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/quadratic.h"
#include "satsurf/core/tensor.h"
#include "satsurf/mesh/mesh.h"

#include <span>
#include <vector>

namespace satsurf::mesh {

/// What one camera sees of a surface.
struct HeightImage {
  Tensor height;               ///< [H W] local z of what each pixel sees, m; NaN where nothing
  Tensor confidence;           ///< [H W] in [0, 1], or empty for 1 everywhere
  Tensor rgb;                  ///< [3 H W] in [0, 1], or empty
  Quadratic pixel_from_local;  ///< (x, y, z) m -> px
  Quadratic local_from_pixel;  ///< (x px, y px, z m) -> (x, y) m
};

/// How views are fused.
struct FusionOptions {
  double voxel = 1;       ///< side, m; two ground pixels keep what the heights have in them
  double truncation = 5;  ///< largest signed distance kept, voxels, 2 to 8
};

/// A truncated signed distance around a surface, positive outside. Voxels stand on a grid whose
/// points are whole multiples of the side; they are kept in tiles of kTile x kTile columns, each
/// with the layers that hold surface and a margin.
struct Tsdf {
  static constexpr Index kTile = 8;
  /// Layers [bottom, bottom + layers) of one tile, from `first` in `values`.
  struct Tile {
    Index bottom = 0, layers = 0;
    std::size_t first = 0;
  };

  double voxel = 1, truncation = 5;
  Index column = 0, row = 0;  ///< of the first voxel: it is centred at column x voxel, row x voxel
  Index columns = 0, rows = 0;  ///< of tiles, eastwards and northwards
  std::vector<Tile> tiles;      ///< rows x columns
  Tensor values;                ///< [layer][row in tile][column in tile] m, NaN where unknown

  /// Value of the voxel that is i to the east and j to the north of the first, in layer k (centred
  /// at z = k voxel); NaN where there is none.
  float at(Index i, Index j, Index k) const;
};

/// Fuses what cameras see into one signed distance. A voxel at p that a view sees at pixel q has
///   d = (z_p - H(q)) |v|,   v the ground displacement along q's ray per metre of height, v_z = 1,
/// the distance along the view's own ray, cut at the truncation. The views' d are averaged with
///   w = cos(normal, ray) confidence f(d),   f = 1 down to -1 voxel, falling to 0.01 at -2.5.
/// So a voxel that every view of it takes to be behind its surface is solid: what no view has seen
/// empty is not carved. One that no view has a height for is unknown. H is bilinear, and the
/// nearest pixel's where neighbours are further apart than the truncation; normals come from
/// differences of H. Pixels that stand out from both neighbours by more than the truncation, or
/// face their ray so obliquely (cos < 0.03) that they show a jump and no surface, say nothing.
/// Source: Curless and Levoy 1996. f is ours: a view that sees past a wall knows more of the space
/// in front of it than one to which it lies behind a roof, and without f walls bulge outwards. The
/// rest of f, also beyond the truncation, keeps a single wrong pixel from drilling a shaft.
/// views     of one surface
/// returns   the field, the same bits for any number of threads
/// throws    ShapeError, ConfigError; Error if there are no heights or too many voxels for the
///           memory
/// cost      O(voxels near the surface x views)
Tsdf fuse(std::span<const HeightImage> views, const FusionOptions& options);

/// Colours a mesh from the pictures: per vertex their average with the weights of `fuse`. A vertex
/// that no picture shows gets the colour of what hides it; one outside all pictures is grey.
/// mesh      takes the colours; none where no view has a picture
/// views     as given to `fuse`; those without `rgb` count for nothing
/// throws    ShapeError
void colour_vertices(Mesh& mesh, std::span<const HeightImage> views, const FusionOptions& options);

}  // namespace satsurf::mesh

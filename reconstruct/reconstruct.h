// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/model.h"
#include "satsurf/reconstruct/plan.h"

#include <vector>

namespace satsurf::reconstruct {

/// A surface on a grid and the surfels behind it. Local x, y, z become easting, northing and height
/// above the ellipsoid by adding the origin of `frame`.
struct Reconstruction {
  rpc::LocalFrame frame;  ///< the scene's: UTM zone and origin
  /// Heights that were searched, local m: the scene's, or less where those were generous.
  rpc::HeightRange z_range;
  scene::HeightField dsm;  ///< local z in m, NaN where nothing was seen
  Tensor confidence;       ///< [H W] in [0, 1], NaN like the DSM
  Tensor sigma;            ///< [H W] m, NaN alike; only of a refined surface, else empty
  /// In the local frame; those on a refined surface face their cameras, as the views that become a
  /// mesh want them. `delivered_surfels` lays them in the surface.
  splat::Surfels surfels;
  /// The scene's images, whole, each with the one camera that was fitted to it.
  std::vector<nn::PosedImage> images;
  Index tiles = 0;
  /// How often a height of one image was compared with that of another at the same place, and agreed to
  /// a pixel of parallax, see `surfel_evidence`; 0 for a splatted surface.
  Index compared = 0, agreed = 0;
  Index levelled = 0;       ///< cells that got the height of a shore, see `level_water`
  Index evened = 0;         ///< cells in doubt and without texture, see `even_untextured`
  double voxel = 0;         ///< see ReconstructPlan
  double completeness = 0;  ///< share of the common footprint's cells that got a height
  /// Largest distance between a camera and the quadratics that stood in for it, px. Above 0.1 it
  /// begins to show in the heights.
  double camera_fit_max_px = 0;
  double planned_memory_bytes = 0;             ///< see ReconstructPlan
  double planned_mesh_bytes = 0;               ///< alike, `mesh_bytes`
  std::vector<nn::PartMemory> planned_memory;  ///< alike
  std::vector<nn::PartMemory> memory;          ///< the same parts, measured
};

/// What `reconstruct` is going to make of a scene, within the heights that it will search: it looks at
/// smaller images for them, as that does (see `narrowed_range`).
/// throws  as `reconstruct`, but where the memory does not suffice
ReconstructPlan plan_of_run(const nn::Model& model, const scene::Scene& scene,
                            const ReconstructOptions& options);

/// Runs the network over all views of the scene (each is a source) and makes one surface of their
/// surfels. Neither reads nor writes files.
/// throws  Error if fewer than two views see a common ground, or if the memory does not suffice;
///         what `options.progress` throws
Reconstruction reconstruct(const nn::Model& model, const scene::Scene& scene,
                           const ReconstructOptions& options);

/// What a surface network is given for a scene, and where.
struct UnrefinedSurface {
  nn::SurfaceInput input;
  double x0 = 0, y0 = 0, step = 0;  ///< of its grid, as HeightField
};
/// A reconstruction up to where the surface network begins: what that one is trained with.
/// throws  as `reconstruct`
UnrefinedSurface unrefined_surface(const nn::Model& model, const scene::Scene& scene,
                                   const ReconstructOptions& options);

}  // namespace satsurf::reconstruct

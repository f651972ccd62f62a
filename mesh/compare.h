// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/shape.h"
#include "satsurf/mesh/mesh.h"

#include <array>
#include <cstdint>
#include <vector>

namespace satsurf::mesh {

/// How meshes are compared.
struct CompareOptions {
  double density = 4;      ///< samples per m^2 of surface
  Index most = 2'000'000;  ///< samples of a mesh; the density falls where it would be more
  double cap = 20;         ///< m; a larger distance counts as this
  std::uint64_t seed = 0;  ///< of the samples
};

/// Points spread over a mesh by area, and the faces they lie on.
struct Samples {
  std::vector<std::array<float, 3>> points;  ///< m
  std::vector<std::uint32_t> faces;
};
/// Uniform over the surface: one point in each of n equal shares of the area, in the order of the
/// faces, at a random place of its share. The same for any number of threads.
/// throws  Error for a mesh without area
Samples sample_surface(const Mesh& mesh, const CompareOptions& options);

/// At one threshold: the shares of distances below it.
struct FScore {
  double threshold = 0;                      ///< m
  double precision = 0, recall = 0, f1 = 0;  ///< of the mesh, of the reference, harmonic mean
};
/// How near two surfaces are.
struct SurfaceScores {
  double chamfer = 0;                    ///< half the sum of the next two, m
  double to_reference = 0, to_mesh = 0;  ///< mean distances of mesh and of reference samples, m
  std::array<FScore, 3> f;               ///< at 0.5, 1 and 2.5 m
  Index mesh_samples = 0, reference_samples = 0;
};
/// Of whole surfaces, and of their parts that are no walls: samples on faces with |n_z| > 0.5, on
/// both sides. NaN where one side has none.
struct MeshComparison {
  SurfaceScores all, without_walls;
};

/// Compares two meshes in one frame. The distance of a sample is that to the nearest of the faces
/// on which the four nearest samples of the other mesh lie: exact on all but very uneven meshes,
/// and without the half spacing that distances between samples alone would add.
///   chamfer = (mean min(d(P -> G), cap) + mean min(d(G -> P), cap)) / 2
/// returns  the same numbers for any number of threads
/// throws   Error for a mesh without area
MeshComparison compare_meshes(const Mesh& mesh, const Mesh& reference,
                              const CompareOptions& options = {});

}  // namespace satsurf::mesh

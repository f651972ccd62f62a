// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/model.h"
#include "satsurf/scene/crop.h"

#include <functional>
#include <optional>
#include <string>
#include <vector>

namespace satsurf::reconstruct {

/// How a surface is made.
struct ReconstructOptions {
  double resolution = 0;  ///< DSM cell, m; 0: the mean ground footprint of a source pixel
  /// Window side, px; 0: the whole image up to 1280, else overlapping tiles of 768.
  Index tile = 0;
  /// Voxel of the mesh that will be made of it, m, 0 for two ground pixels; none without a mesh.
  std::optional<double> mesh;
  /// May be empty, and may throw to stop. Called often, also without progress.
  std::function<void(const std::string& stage, double fraction)> progress;
};

/// A surface on a grid and the surfels behind it.
struct Reconstruction {
  scene::HeightField dsm;  ///< local z in m, NaN where nothing was seen
  Tensor confidence;       ///< [H W] in [0, 1], NaN like the DSM
  splat::Surfels surfels;  ///< in the local frame
  Index tiles = 0;
  double voxel = 0;         ///< see ReconstructPlan
  double completeness = 0;  ///< share of the common footprint's cells that got a height
  /// Largest distance between a camera and the quadratics that stood in for it, px. Above 0.1 it
  /// begins to show in the heights.
  double camera_fit_max_px = 0;
  double planned_memory_bytes = 0;             ///< see ReconstructPlan
  std::vector<nn::PartMemory> planned_memory;  ///< alike
  std::vector<nn::PartMemory> memory;          ///< the same parts, measured
};

/// A rectangle of ground, local m.
struct Ground {
  double x0 = 0, y0 = 0, x1 = 0, y1 = 0;
  double width() const { return x1 - x0; }
  double height() const { return y1 - y0; }
};

/// What `reconstruct` is going to do.
struct ReconstructPlan {
  Ground ground;                ///< that two views see
  double east = 0, north = 0;   ///< upper-left corner of the DSM, local m
  double step = 0;              ///< its cell, m
  double voxel = 0;             ///< of the mesh, m; 0 without one
  Index height = 0, width = 0;  ///< its cells
  Index window = 0;             ///< side of the network's windows, px
  std::vector<Ground> tiles;    ///< what each window answers for
  double memory_bytes = 0;      ///< of the whole program, within a tenth
  /// Tensors of the network's parts, then of "surface", each within a tenth.
  std::vector<nn::PartMemory> memory;
};
/// Sizes and memory of a reconstruction, before it begins.
/// throws  Error if fewer than two views see a common ground
ReconstructPlan plan_reconstruction(const nn::ModelConfig& model, const scene::Scene& scene,
                                    const ReconstructOptions& options);

/// Runs the network over all views of the scene (each is a source) and renders the surface from
/// above.
/// throws  Error if fewer than two views see a common ground, or if the memory does not suffice
Reconstruction reconstruct(const nn::Model& model, const scene::Scene& scene,
                           const ReconstructOptions& options);

}  // namespace satsurf::reconstruct

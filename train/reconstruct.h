// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/model.h"
#include "satsurf/train/dataset.h"

#include <functional>
#include <optional>
#include <string>
#include <vector>

namespace satsurf::train {

/// How a surface is made.
struct ReconstructOptions {
  double resolution = 0;  ///< DSM cell, m; 0: the mean ground footprint of a source pixel
  /// Window side, px; 0: the whole image up to 1280, else overlapping tiles of 768.
  Index tile = 0;
  std::function<void(const std::string& stage, double fraction)> progress;  ///< may be empty
};

/// A surface on a grid and the surfels behind it.
struct Reconstruction {
  HeightField dsm;         ///< local z in m, NaN where nothing was seen
  Tensor confidence;       ///< [H W] in [0, 1], NaN like the DSM
  splat::Surfels surfels;  ///< in the local frame
  Index tiles = 0;
  double completeness = 0;  ///< share of the common footprint's cells that got a height
};

/// Runs the network over all views of the scene (each is a source) and renders the surface from
/// above.
/// throws  Error if fewer than two views see a common ground
Reconstruction reconstruct(const nn::Model& model, const Scene& scene,
                           const ReconstructOptions& options);

/// Heights of a rendered surface [H W]: the median, which keeps edges sharp, where at least half
/// the light is stopped; the mean where surfels are sparser than that, as on ground seen at a
/// grazing angle; NaN where next to nothing (less than 0.05) is.
Tensor surface_heights(const splat::Render& render);

/// The camera that looks straight down on a grid.
/// x0, y0   upper-left corner, local m
/// step     side of a cell, m
/// returns  local x, y, z in m -> cell
Quadratic nadir_camera(double x0, double y0, double step);

/// Height range of a scene that names none: a coarse sweep by normalised correlation of the views.
/// z_low, z_high  range to search, as a rule the cameras' own, local m
/// returns        lowest and highest height, local m
/// throws         Error if the views do not agree anywhere
std::pair<double, double> find_height_range(const Scene& scene, double z_low, double z_high);

}  // namespace satsurf::train

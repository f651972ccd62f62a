// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/rng.h"
#include "satsurf/nn/scene.h"
#include "satsurf/rpc/fit.h"
#include "satsurf/train/raycast.h"

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

namespace satsurf::train {

/// One image with its camera and date.
struct SceneView {
  std::string name;
  Tensor rgb;    ///< [3 H W] in [0, 1]
  Tensor valid;  ///< [H W]
  rpc::Rpc rpc;
  double sun_elevation_deg = 0, sun_azimuth_deg = 0;
  std::string date;
};

/// Images of one place, and what is known of its surface.
struct Scene {
  std::string name;
  rpc::LocalFrame frame;
  std::vector<SceneView> views;
  std::optional<HeightField> truth;  ///< in the local frame
  Tensor classes;                    ///< [H W] on the truth's grid, or empty; 9 = water
  double z_low = 0, z_high = 0;      ///< height range in the local frame, m
};

/// Scenes of a folder: the layout `simulate` writes, DFC2019 Track 3 (`Track3-RGB`, `Track3-Truth`)
/// or EOGS
/// (`images`, `rpcs`, `truth`). Scenes come sorted by name. throws IoError
std::vector<std::string> list_scenes(const std::filesystem::path& folder);
Scene load_scene(const std::filesystem::path& folder, const std::string& name);

/// A square window of every chosen view around one ground point, ready for the network.
struct Crop {
  nn::SceneInput input;
  std::optional<nn::View> target;  ///< the view to be rendered, not among the sources
  /// True heights of source views, [stage][view] -> [h w], local z in m, NaN where unknown. Empty
  /// without truth.
  std::vector<std::vector<Tensor>> source_truth;
  Tensor target_truth;  ///< [H W], or empty
};

/// Cuts windows of `size` pixels (a multiple of the network's) centred on local (x, y) at height z
/// from the source views and, if given, from `target`. Pixels outside an image are invalid.
Crop make_crop(const Scene& scene, const std::vector<Index>& sources, std::optional<Index> target,
               double x, double y, double z, Index size, double z_low, double z_high,
               bool with_truth);

}  // namespace satsurf::train

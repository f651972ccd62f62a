// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/rng.h"
#include "satsurf/nn/scene.h"
#include "satsurf/rpc/fit.h"
#include "satsurf/rpc/read.h"
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
  std::filesystem::path file{};  ///< what it was read from
};

/// A view with all that its image says; named after its image file.
/// file    what it was read from, an image or a JSON file that names one
SceneView view_of(const rpc::Image& image, const std::filesystem::path& file);

/// Images of one place, and what is known of its surface.
struct Scene {
  std::string name;
  rpc::LocalFrame frame;
  std::vector<SceneView> views;
  std::optional<HeightField> truth;          ///< in the local frame
  Tensor classes;                            ///< [H W] on the truth's grid, or empty; 9 = water
  double z_low = 0, z_high = 0;              ///< height range in the local frame, m
  std::filesystem::path images, truth_file;  ///< the data set, and where its truth is or should be
};

/// The scenes of a data set, sorted by name. `folder` has one of these layouts:
///   simulate, DFC2019 Track 3  Track3-RGB/SCENE_001_RGB.tif ..., Track3-Truth/
///   EOGS                       images/SCENE/, rpcs/SCENE/NAME.json (else RPC tags), truth/SCENE/
///   Sat-NeRF                   train.txt and test.txt beside the JSON files they list: one scene,
///                              named for the folder; or a folder of such folders
/// throws IoError naming the folder and the layouts, or the line of a split file that names nothing
std::vector<std::string> list_scenes(const std::filesystem::path& folder);

/// Reads one scene: its images, cameras and, where it is found, SCENE_DSM.tif with SCENE_CLS.tif.
/// Views are sorted by name; those of Sat-NeRF come as train.txt and then test.txt list them, their
/// images and truth from the scene's folder or the usual places up to three folders above it.
/// The height range is the truth's, or without truth that of the JSON files; it stays 0 to 0 where
/// there is neither.
/// throws IoError naming the file and, for one that is missing, where it was looked for; also for
///        a truth of several bands and for classes that are not on the DSM's grid
Scene load_scene(const std::filesystem::path& folder, const std::string& name);

/// A square window of every chosen view around one ground point, ready for the network.
struct Crop {
  nn::SceneInput input;
  std::optional<nn::View> target;  ///< the view to be rendered, not among the sources
  /// True heights of source views, [stage][view] -> [h w], local z in m, NaN where unknown.
  /// Empty without truth.
  std::vector<std::vector<Tensor>> source_truth;
  Tensor target_truth;  ///< [H W], or empty
};

/// Cuts windows of the views around one ground point. Pixels outside an image are invalid.
/// sources        views the network is given, by index
/// target         the view to be rendered, if there is one
/// x, y, z        ground point in the middle of every window, local m
/// size           side of the windows, px, a multiple of the network's
/// z_low, z_high  height range of the crop, local m
/// with_truth     fill the true heights in, where the scene has them
Crop make_crop(const Scene& scene, const std::vector<Index>& sources, std::optional<Index> target,
               double x, double y, double z, Index size, double z_low, double z_high,
               bool with_truth);

}  // namespace satsurf::train

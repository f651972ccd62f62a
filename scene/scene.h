// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/rpc/frame.h"
#include "satsurf/rpc/read.h"
#include "satsurf/scene/raycast.h"

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

namespace satsurf::scene {

/// One image with its camera and date.
struct View {
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
View view_of(const rpc::Image& image, const std::filesystem::path& file);

/// Images of one place, and what is known of its surface.
struct Scene {
  std::string name;
  rpc::LocalFrame frame;
  std::vector<View> views;
  std::optional<HeightField> truth;          ///< in the local frame
  Tensor classes;                            ///< [H W] on the truth's grid, or empty; 9 = water
  double z_low = 0, z_high = 0;              ///< height range in the local frame, m
  std::filesystem::path images, truth_file;  ///< the data set, and where its truth is or should be
};

}  // namespace satsurf::scene

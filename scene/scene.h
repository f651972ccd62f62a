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
  std::filesystem::path file{};  ///< what it was read from, empty for an image in memory
  std::vector<std::filesystem::path> files{};  ///< all that was read for it
  Index bands = 3;                             ///< of the image
  std::string dtype = "uint8";                 ///< of the image, see rpc::RasterInfo
  rpc::RgbChoice colours{};                    ///< what of its values became `rgb`
  double border = 0;  ///< share of its pixels that are a border of one value, and not valid

  Index height() const { return rgb.dim(1); }
  Index width() const { return rgb.dim(2); }
  /// What messages call it: its file, or its name where it has none.
  std::string label() const { return file.empty() ? name : file.string(); }
  /// Whether a point falls into the image. Hidden ground counts.
  bool contains(const rpc::Geodetic& p) const {
    return rpc::inside_image(rpc.project(p), width(), height());
  }
  /// Whether it falls onto a valid pixel.
  bool shows(const rpc::Geodetic& p) const;
};

/// A view with all that its image says; named after its image file.
/// file    what it was read from, an image or a JSON file that names one
View view_of(const rpc::Image& image, const std::filesystem::path& file);

/// Images of one place, and what is known of its surface. All heights are local z.
struct Scene {
  std::string name;
  rpc::LocalFrame frame;
  std::vector<View> views;
  std::optional<HeightField> truth;  ///< in the local frame
  Tensor classes;                    ///< [H W] on the truth's grid, or empty; 9 = water
  rpc::HeightRange z_range;          ///< of the surface, local m
  /// Part of it at which the images were seen to agree; known only where the range was searched for.
  std::optional<rpc::HeightRange> z_agreed{};
  std::filesystem::path images, truth_file;  ///< the data set, and where its truth is or should be
};

}  // namespace satsurf::scene

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/rpc/read.h"
#include "satsurf/scene/pointing.h"
#include "satsurf/scene/view_geometry.h"

#include <array>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace satsurf::app {

/// Where a camera stands and what it sees.
struct CameraFacts {
  double height = 0;  ///< at which the rest is told, m above the ellipsoid
  rpc::Geodetic centre;
  rpc::UtmZone zone;
  std::vector<std::array<double, 2>> footprint;  ///< corners, longitude and latitude
  double footprint_km2 = 0;
  scene::ViewAngles view;
};
/// What a file says of an image.
struct ImageFacts {
  std::filesystem::path file;  ///< as it was named
  rpc::RasterInfo info;
  std::optional<CameraFacts> camera;
  std::string damage;  ///< why its pixels cannot be read; empty where they can
};
/// What a file of weights holds.
struct WeightsFacts {
  std::filesystem::path file;
  std::map<std::string, std::string> metadata;
  std::string network;  ///< its size and configuration, in words
  std::string surface;  ///< alike of the surface network; empty without one
};
/// How two images lie to each other.
struct PairFacts {
  std::size_t a = 0, b = 0;  ///< of the images with cameras
  double height = 0;         ///< at which it is told, m above the ellipsoid
  double overlap = 0;        ///< share of the smaller image
  double parallax = 0;       ///< px per metre of height; 0 without overlap
  std::string unknown{};     ///< why a camera says nothing of it; empty where both do
};
/// How the cameras agree.
struct PointingFacts {
  std::optional<scene::Pointing> measured;
  std::string not_measured;  ///< in words: why not
};
/// All that `info` found out.
struct Info {
  std::vector<ImageFacts> images;
  std::vector<std::size_t> cameras;  ///< which of them have one, and sound pixels
  std::vector<WeightsFacts> weights;
  std::vector<PairFacts> pairs;
  PointingFacts pointing;                                             ///< of two or more cameras
  std::vector<std::pair<std::filesystem::path, std::string>> failed;  ///< and why
};

/// Looks into images and weights. A file that cannot be read goes to `failed`, and the others are
/// looked at all the same. Pixels are read once, those of large images only where a file that was cut
/// off lacks them (see `rpc::check_pixels`).
/// image_dirs  where else to look for the images JSON files name
Info info_of(const std::vector<std::filesystem::path>& files,
             const std::vector<std::filesystem::path>& image_dirs);

/// The same as one document: files (each with its path and kind, or an error), pairs, pointing.
nlohmann::ordered_json info_json(const Info& info);

}  // namespace satsurf::app

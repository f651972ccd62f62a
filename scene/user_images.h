// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/rpc/read.h"
#include "satsurf/scene/polygon.h"
#include "satsurf/scene/scene.h"

#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

namespace satsurf::scene {

/// The four corners of an image on the ground.
/// width, height  of the image, px
/// zone           of the result
/// h              m above the ellipsoid
/// throws         Error
Polygon footprint(const rpc::Rpc& rpc, Index width, Index height, const rpc::UtmZone& zone,
                  double h);

/// How a camera looks at its image's centre at height h.
struct ViewAngles {
  double gsd = 0;            ///< ground size of a pixel across the ray, m
  double off_nadir_deg = 0;  ///< between the ray and the vertical at the ground
  double azimuth_deg = 0;    ///< from the ground towards the satellite, clockwise from north
};
/// Those of an image of width x height px at h m above the ellipsoid.
/// throws  Error
ViewAngles view_angles(const rpc::Rpc& rpc, Index width, Index height, double h);

/// Pixels by which a ground point moves in `b` against `a` per metre of height, at (lon, lat, h).
double parallax(const rpc::Rpc& a, const rpc::Rpc& b, const rpc::Geodetic& p);

/// What is known of the surface's height before the images have been compared.
struct RangeChoice {
  rpc::HeightRange range;  ///< m above the ellipsoid
  std::string source;      ///< in words: where it came from
};

/// A scene of a user's own images.
struct UserScene {
  Scene scene;
  RangeChoice range;
  double common_area = 0;  ///< ground that all views see, m2
};
/// Opens every view, checks that each pair sees common ground, and chooses the frame (UTM zone and
/// rounded centre of the common ground, height origin in the middle of the height range).
/// files       two or more images or Sat-NeRF JSON files
/// image_dirs  where else to look for the images that JSON files name
/// wanted      height range; else the one the images' metadata name, else it is searched for with
///             `find_height_range`
/// poll        called often, may throw to stop
/// throws      IoError for a file that cannot be used (missing, too small, without texture),
///             ConfigError for a wanted range that is not the cameras', Error for images without
///             overlap or parallax, each naming the files
UserScene scene_from_views(const std::vector<std::filesystem::path>& files,
                           const std::vector<std::filesystem::path>& image_dirs,
                           const std::optional<rpc::HeightRange>& wanted,
                           const std::function<void()>& poll = {});

}  // namespace satsurf::scene

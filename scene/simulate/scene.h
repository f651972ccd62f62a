// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/fields.h"
#include "satsurf/rpc/frame.h"
#include "satsurf/rpc/model.h"
#include "satsurf/rpc/raster.h"
#include "satsurf/scene/raycast.h"
#include "satsurf/scene/simulate/kind.h"

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

namespace satsurf::scene {

/// Which scenes to make up.
struct SimulateConfig {
  Index scenes = 8;
  std::uint64_t seed = 0;
  Index pixels = 512;  ///< rows and columns of every image
  Index views = 5;
  double gsd = 0;   ///< m; 0 draws 0.3 to 0.6 for each scene
  double cell = 0;  ///< of the surface, m; 0 is 0.25 for pixels below 0.4 m, 0.3 for others
  std::vector<SceneKind> kinds{SceneKind::city,    SceneKind::suburb, SceneKind::industrial,
                               SceneKind::village, SceneKind::rural,  SceneKind::rough};
  /// How often each of `kinds` is drawn; empty: equally often.
  std::vector<double> kind_weights;
  double relief_max = 60;     ///< m
  double tallest_max = 150;   ///< m
  double water = 0.15;        ///< share of the scenes
  double dark = 0;            ///< share of the scenes
  double crags = 0;           ///< share of the rural and the rough scenes
  double panchromatic = 0.4;  ///< share of the scenes
  double same_pass = 0.4;     ///< share of the scenes
  double off_nadir_min_deg = 5, off_nadir_max_deg = 32;
  double parallax_min = 0.3, parallax_max = 2;  ///< px per m, between any two views
  double bias_px = 0;   ///< largest shift of the given cameras from the true ones
  bool heights = true;  ///< also give the height of every pixel; no field, as no file has them

  template <class Self, class V>
  static void fields(Self& s, V&& v) {
    v("scenes", s.scenes, Field{.help = "scenes to make", .min = 1});
    v("seed", s.seed, Field{.help = "same seed, same scenes"});
    v("pixels", s.pixels,
      Field{.help = "rows and columns of every image", .unit = "px", .min = 16, .max = 16384});
    v("views", s.views, Field{.help = "images per scene", .min = 1, .max = 32});
    v("gsd", s.gsd,
      Field{.help = "ground size of a pixel; 0 draws 0.3 to 0.6 per scene",
            .unit = "m",
            .min = 0,
            .max = 5});
    v("cell", s.cell,
      Field{.help =
                "cells of the surface that the images show, of which large scenes have many; 0: "
                "0.25 where pixels are below 0.4 m, else 0.3, and those of a given surface",
            .unit = "m",
            .min = 0,
            .max = 5});
    v("kinds", s.kinds,
      Field{.help = "kinds of scenes, drawn with equal chance unless kind_weights says otherwise"});
    v("kind_weights", s.kind_weights,
      Field{.help = "how often each of the kinds is drawn, one number for each of --kinds, of any "
                    "sum",
            .min = 0,
            .automatic = "equally often"});
    v("relief_max", s.relief_max,
      Field{.help =
                "caps the ground's deviation from its mean, of which no kind draws more than 60, "
                "or 110 with crags",
            .unit = "m",
            .min = 0.5,
            .max = 500});
    v("tallest_max", s.tallest_max,
      Field{.help = "caps the height above the ground, of which no kind draws more than 150",
            .unit = "m",
            .min = 24,
            .max = 300});
    v("water", s.water,
      Field{.help = "share of scenes with a river or a lake", .min = 0, .max = 1});
    v("dark", s.dark,
      Field{.help = "share of scenes with soil, rock and plants that are dark without a shadow: "
                    "lava, coal, wet and weathered faces, burnt ground",
            .min = 0,
            .max = 1});
    v("crags", s.crags,
      Field{.help =
                "share of the rural and the rough scenes that are open pits, two of five, or have "
                "rock that stands out of steeper ground, and gullies, whose shadows fall on "
                "slopes",
            .min = 0,
            .max = 1});
    v("panchromatic", s.panchromatic, Field{.help = "share of scenes in grey", .min = 0, .max = 1});
    v("same_pass", s.same_pass,
      Field{.help = "share of scenes taken within minutes from one orbit", .min = 0, .max = 1});
    v("off_nadir_min_deg", s.off_nadir_min_deg,
      Field{.help = "least off-nadir angle", .unit = "deg", .min = 0, .max = 45});
    v("off_nadir_max_deg", s.off_nadir_max_deg,
      Field{.help = "largest off-nadir angle", .unit = "deg", .min = 1, .max = 45});
    v("parallax_min", s.parallax_min,
      Field{.help = "least parallax between two views", .unit = "px/m", .min = 0});
    v("parallax_max", s.parallax_max,
      Field{.help = "largest parallax between two views", .unit = "px/m", .min = 0});
    v("bias_px", s.bias_px,
      Field{.help = "largest shift of the given cameras from the true ones",
            .unit = "px",
            .min = 0,
            .max = 50});
  }
};

/// throws ConfigError for fields out of their range or at odds with each other
void check_config(const SimulateConfig& config);

/// One made-up image.
struct SimulatedView {
  Tensor rgb;  ///< [3 H W] in [0, 1], 256 levels; three equal channels if panchromatic
  rpc::Rpc rpc;
  double sun_elevation_deg = 0, sun_azimuth_deg = 0;  ///< azimuth clockwise from true north
  std::string date;                                   ///< YYYYMMDDHHMMSS, UTC
  Tensor height;  ///< [H W] local z of what each pixel's centre shows, m; empty unless wanted
  double off_nadir_deg = 0, azimuth_deg = 0;  ///< of the line of sight, towards the satellite
  /// How well `rpc`, before its bias, stands for the orbital camera.
  double rpc_rms_px = 0, rpc_max_px = 0;
};

/// One made-up place.
struct SimulatedScene {
  SceneKind kind = SceneKind::city;
  HeightField dsm;  ///< in the local frame, a square that every view lies within
  rpc::LocalFrame frame;
  std::vector<SimulatedView> views;
  Tensor classes;  ///< [H W] on the grid of `dsm`: 2 ground, 5 trees, 6 building, 9 water
  double h_min = 0, h_max = 0;  ///< range of `dsm`, m above the ellipsoid
  double gsd = 0;               ///< m
};

/// Scene number `index` of a seed: a pure function of the arguments, for any number of threads.
/// throws  ConfigError as `check_config`; Error for more than fits into memory
SimulatedScene simulate_scene(const SimulateConfig& config, std::uint64_t seed, Index index);

/// A surface somebody measured, to be lit and looked at instead of a made-up one.
struct GivenSurface {
  Tensor z;        ///< [H W] m above the ellipsoid, row 0 north; NaN where unknown
  Tensor classes;  ///< [H W] as SimulatedScene::classes, anything else is ground; or empty
  rpc::GeoGrid grid;
  rpc::UtmZone zone;
};
/// dsm      any GeoTIFF in a zone of UTM, or DFC2019's without a system
/// classes  on the same grid; or empty
/// throws   IoError
GivenSurface read_surface(const std::filesystem::path& dsm, const std::filesystem::path& classes);

/// Scene number `index` of a seed on a given surface, with made-up materials, light and cameras:
/// another part of it for every scene, mirrored at its edges where the views reach beyond. The
/// configuration's relief_max, tallest_max, water, dark and crags say nothing here, and its kinds only
/// how many pixels of the images are saturated.
/// throws  ConfigError as `check_config`, ShapeError; Error for more than fits into memory
SimulatedScene simulate_on_surface(const GivenSurface& surface, const SimulateConfig& config,
                                   std::uint64_t seed, Index index);

/// Writes a scene in the layout of DFC2019 Track 3:
///   Track3-RGB/NAME_001_RGB.tif ...  uint8, camera in the RPC tag
///   Track3-Truth/                    NAME_DSM.tif, NAME_DSM.txt, NAME_CLS.tif
///   Track3-Metadata/NAME.json        sun, date, angles, height range, zone
/// throws  IoError
void write_scene(const SimulatedScene& scene, const std::filesystem::path& out_dir,
                 const std::string& name);

}  // namespace satsurf::scene

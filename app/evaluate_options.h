// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/app/reconstruct_options.h"
#include "satsurf/core/fields.h"
#include "satsurf/evaluate/metrics.h"

#include <filesystem>
#include <vector>

namespace satsurf::app {

// The four things `evaluate` scores. Each has a configuration, which --json records, and files to
// write beside it.

/// Where `evaluate` puts what it says in all cases.
struct EvaluateOutput {
  std::filesystem::path json;  ///< may be empty
  bool overwrite = false;

  template <class Self, class V>
  static void fields(Self& s, V&& v) {
    v("json", s.json, Field{.help = "all numbers and where they came from"});
    v("overwrite", s.overwrite, Field{.help = "replace files that exist", .flag = "--overwrite"});
  }
};

/// `--register` of a surface and of a data set's surfaces.
inline Field registration_field() {
  return {.help =
              "what is taken out first: nothing, the median offset, or also a shift of up to "
              "15 m, if it leaves smaller errors"};
}
/// `--lpips-weights` of a picture and of a data set's rendered views.
inline Field lpips_field() {
  return {.help =
              "LPIPS v0.1 (alex, squeeze or vgg) as safetensors of its state_dict; no LPIPS of "
              "a picture or a data set's rendered views without",
          .flag = "--lpips-weights,--lpips_weights"};
}

/// One surface against the truth.
struct EvaluateDsmConfig {
  std::filesystem::path dsm, truth, classes;  ///< the last may be empty
  /// Images: only what two of them see is scored; and where else to look for those JSON files name.
  std::vector<std::filesystem::path> seen_by, image_dirs;
  evaluate::Registration registration = evaluate::Registration::none;
  bool mask_water = false;

  template <class Self, class V>
  static void fields(Self& s, V&& v) {
    v("dsm", s.dsm, Field{.help = "surface to score"});
    v("truth", s.truth, Field{.help = "true surface"});
    v("classes", s.classes, Field{.help = "class raster on the truth's grid"});
    v("mask_water", s.mask_water,
      Field{.help = "leave cells of class 9 (water) out", .flag = "--mask-water"});
    v("seen_by", s.seen_by,
      Field{.help = "score only what two or more of these images see",
            .flag = "--seen-by",
            .placeholder = "IMG"});
    v("image_dirs", s.image_dirs,
      Field{.help = "where else to look for the images JSON files name",
            .flag = "--image-dir",
            .placeholder = "DIR"});
    v("register", s.registration, registration_field());
  }
};
struct EvaluateDsmCommand : EvaluateDsmConfig {
  std::filesystem::path error_map;  ///< may be empty

  template <class Self, class V>
  static void fields(Self& s, V&& v) {
    v("error_map", s.error_map,
      Field{.help = "map of the errors, blue too low, red too high, 5 m at most, with a legend "
                    "below; a world file lies beside it",
            .flag = "--error-map",
            .placeholder = "PNG"});
  }
};
void run_evaluate_dsm(const EvaluateDsmCommand& options, const EvaluateOutput& output);

/// A network on a data set.
struct EvaluateDataConfig {
  std::filesystem::path data, weights, lpips_weights;  ///< all but the first may be empty
  Index views = 3, window = 512;
  evaluate::Registration registration = evaluate::Registration::none;
  reconstruct::Surface surface = reconstruct::Surface::automatic;
  double range_above = 0;
  bool mask_water = true, meshes = true;

  template <class Self, class V>
  static void fields(Self& s, V&& v) {
    v("data", s.data, Field{.help = "data set: any layout that train takes", .placeholder = "DIR"});
    v("weights", s.weights,
      Field{.help = "network weights", .automatic = "the shipped ones, or SATSURF_WEIGHTS"});
    v("views", s.views, Field{.help = "source images of each scene", .min = 2, .max = 32});
    v("surface", s.surface, surface_field());
    v("window", s.window,
      Field{.help = "largest side of the window about the truth's middle in which views are scored",
            .unit = "px",
            .min = 64,
            .max = 4096});
    v("range_above", s.range_above,
      Field{.help = "added to the upper end of the scenes' height ranges: what a generous range "
                    "costs",
            .unit = "m",
            .min = 0,
            .max = 5000,
            .flag = "--range-above"});
    v("mask_water", s.mask_water,
      Field{.help = "score cells of class 9 (water) as well", .flag = "--keep-water"});
    v("meshes", s.meshes,
      Field{.help = "do not fuse meshes for chamfer distance and F1, which takes seconds per scene",
            .flag = "--no-meshes"});
    v("register", s.registration, registration_field());
    v("lpips_weights", s.lpips_weights, lpips_field());
  }
};
struct EvaluateDataCommand : EvaluateDataConfig {
  std::filesystem::path csv, confidence_csv, confidence_figure;  ///< may be empty

  template <class Self, class V>
  static void fields(Self& s, V&& v) {
    v("csv", s.csv, Field{.help = "every number, one row per scene and the mean"});
    v("confidence_csv", s.confidence_csv,
      Field{.help = "errors by confidence, of source views and DSM, over all scenes",
            .flag = "--confidence-csv"});
    v("confidence_figure", s.confidence_figure,
      Field{.help = "the same as bar charts", .flag = "--confidence-figure", .placeholder = "SVG"});
  }
};
void run_evaluate_data(const EvaluateDataCommand& options, const EvaluateOutput& output);

/// One picture against another.
struct EvaluateImageConfig {
  std::filesystem::path image, reference, mask, lpips_weights;  ///< the last two may be empty

  template <class Self, class V>
  static void fields(Self& s, V&& v) {
    v("image", s.image,
      Field{.help = "picture to score: PNG, JPEG or TIFF; 8-bit values are divided by 255, 16-bit "
                    "ones by 65535, then all clipped to [0, 1]. Equal pictures: PSNR is infinite, "
                    "in --json null with psnr_infinite true"});
    v("reference", s.reference, Field{.help = "picture it should be"});
    v("mask", s.mask,
      Field{.help = "picture of their size, 0 in every channel where a pixel does not count"});
    v("lpips_weights", s.lpips_weights, lpips_field());
  }
};
void run_evaluate_image(const EvaluateImageConfig& options, const EvaluateOutput& output);

/// One mesh against another.
struct EvaluateMeshConfig {
  std::filesystem::path mesh, reference_mesh;

  template <class Self, class V>
  static void fields(Self& s, V&& v) {
    v("mesh", s.mesh, Field{.help = "mesh to score: a binary PLY"});
    v("reference_mesh", s.reference_mesh,
      Field{.help = "mesh it should be, in the same system", .flag = "--reference-mesh"});
  }
};
void run_evaluate_mesh(const EvaluateMeshConfig& options, const EvaluateOutput& output);

}  // namespace satsurf::app

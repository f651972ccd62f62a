// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/evaluate_flags.h"

#include "satsurf/app/commands.h"
#include "satsurf/core/error.h"

#include <algorithm>
#include <filesystem>
#include <string>
#include <utility>
#include <vector>

namespace satsurf::app {
namespace {

// Headings of the help. An option may be given with whatever stands in the heading it is under.
constexpr const char* kSurface = "One surface";
constexpr const char* kData = "A data set";
constexpr const char* kPicture = "One picture";
constexpr const char* kMesh = "One mesh";
constexpr const char* kSurfaceOrData = "One surface or a data set";
constexpr const char* kDataOrPicture = "A data set or one picture";

/// Values that more than one mode takes.
struct Shared {
  std::string registration = "none";
  std::filesystem::path lpips_weights, json;
  bool overwrite = false;
};

/// One thing to score.
struct Mode {
  CLI::Option* chooser;             ///< the option that asks for it
  const CLI::Option* partner;       ///< another that must be there; nullptr for none
  std::vector<std::string> groups;  ///< headings of its options
  std::function<void()> run;

  bool chosen() const { return chooser->count() > 0; }
  bool has(const std::string& group) const {
    return std::ranges::find(groups, group) != groups.end();
  }
};

Mode add_surface(CLI::App& command, const Shared& shared) {
  static EvaluateDsmOptions o;
  CLI::Option* dsm =
      command.add_option("--dsm", o.dsm, "surface to score")->type_name("FILE")->group(kSurface);
  CLI::Option* truth =
      command.add_option("--truth", o.truth, "true surface")->type_name("FILE")->group(kSurface);
  command.add_option("--classes", o.classes, "class raster on the truth's grid")
      ->type_name("FILE")
      ->group(kSurface);
  command.add_flag("--mask-water", o.mask_water, "leave cells of class 9 (water) out")
      ->group(kSurface);
  command.add_option("--seen-by", o.seen_by, "score only what two or more of these images see")
      ->type_name("IMG")
      ->group(kSurface);
  command
      .add_option("--image-dir", o.image_dirs, "where else to look for the images JSON files name")
      ->type_name("DIR")
      ->group(kSurface);
  command
      .add_option("--error-map", o.picture,
                  "picture of the errors, blue too low, red too high, 5 m at most")
      ->type_name("PNG")
      ->group(kSurface);
  return {dsm, truth, {kSurface, kSurfaceOrData}, [&shared] {
            o.registration = shared.registration, o.json = shared.json;
            o.overwrite = shared.overwrite;
            run_evaluate_dsm(o);
          }};
}

Mode add_data(CLI::App& command, const Shared& shared) {
  static EvaluateDataOptions o;
  static bool keep_water = false, no_meshes = false;
  CLI::Option* data = command.add_option("--data", o.data, "data set: any layout that train takes")
                          ->type_name("DIR")
                          ->group(kData);
  command
      .add_option("--weights", o.weights, "network weights [the shipped ones, or SATSURF_WEIGHTS]")
      ->type_name("FILE")
      ->group(kData);
  command.add_option("--views", o.views, "source images of each scene")
      ->type_name("N")
      ->capture_default_str()
      ->check(CLI::Range(2, 32).description(""))
      ->group(kData);
  command.add_flag("--keep-water", keep_water, "score cells of class 9 (water) as well")
      ->group(kData);
  command
      .add_flag("--no-meshes", no_meshes,
                "do not fuse meshes for chamfer distance and F1, which takes seconds per scene")
      ->group(kData);
  command.add_option("--csv", o.csv, "every number, one row per scene and the mean")
      ->type_name("FILE")
      ->group(kData);
  command
      .add_option("--confidence-csv", o.confidence_csv,
                  "errors by confidence, of source views and DSM, over all scenes")
      ->type_name("FILE")
      ->group(kData);
  command.add_option("--confidence-figure", o.confidence_figure, "the same as bar charts")
      ->type_name("SVG")
      ->group(kData);
  return {data, nullptr, {kData, kSurfaceOrData, kDataOrPicture}, [&shared] {
            o.registration = shared.registration, o.lpips_weights = shared.lpips_weights;
            o.json = shared.json, o.overwrite = shared.overwrite;
            o.mask_water = !keep_water, o.meshes = !no_meshes;
            run_evaluate_data(o);
          }};
}

Mode add_picture(CLI::App& command, const Shared& shared) {
  static EvaluateImageOptions o;
  CLI::Option* image = command
                           .add_option("--image", o.image,
                                       "picture to score: PNG, JPEG or TIFF; 8-bit values are "
                                       "divided by 255, 16-bit ones by 65535, then all clipped to "
                                       "[0, 1]. Equal pictures: PSNR is infinite, in --json null "
                                       "with psnr_infinite true")
                           ->type_name("FILE")
                           ->group(kPicture);
  CLI::Option* reference = command.add_option("--reference", o.reference, "picture it should be")
                               ->type_name("FILE")
                               ->group(kPicture);
  command
      .add_option("--mask", o.mask,
                  "picture of their size, 0 in every channel where a pixel does not count")
      ->type_name("FILE")
      ->group(kPicture);
  return {image, reference, {kPicture, kDataOrPicture}, [&shared] {
            o.lpips_weights = shared.lpips_weights, o.json = shared.json;
            o.overwrite = shared.overwrite;
            run_evaluate_image(o);
          }};
}

Mode add_mesh(CLI::App& command, const Shared& shared) {
  static EvaluateMeshOptions o;
  CLI::Option* mesh = command.add_option("--mesh", o.mesh, "mesh to score: a binary PLY")
                          ->type_name("FILE")
                          ->group(kMesh);
  CLI::Option* reference =
      command.add_option("--reference-mesh", o.reference, "mesh it should be, in the same system")
          ->type_name("FILE")
          ->group(kMesh);
  return {mesh, reference, {kMesh}, [&shared] {
            o.json = shared.json, o.overwrite = shared.overwrite;
            run_evaluate_mesh(o);
          }};
}

void add_shared(CLI::App& command, Shared& o) {
  command
      .add_option("--register", o.registration,
                  "what is taken out first: none, z (the median offset) or xyz")
      ->type_name("HOW")
      ->capture_default_str()
      ->group(kSurfaceOrData);
  command
      .add_option("--lpips-weights,--lpips_weights", o.lpips_weights,
                  "LPIPS v0.1 (alex, squeeze or vgg) as safetensors of its state_dict; no LPIPS of "
                  "a picture or a data set's rendered views without")
      ->type_name("FILE")
      ->group(kDataOrPicture);
  command.add_option("--json", o.json, "all numbers and where they came from")->type_name("FILE");
  command.add_flag("--overwrite", o.overwrite, "replace files that exist");
}

/// throws  ConfigError for an option that only other modes have
void refuse_others(const CLI::App& command, const std::vector<Mode>& modes, const Mode& mode) {
  for (const CLI::Option* option : command.get_options()) {
    const std::string& group = option->get_group();
    if (option->count() == 0 || mode.has(group)) continue;
    std::string wanted;  // stays empty for what every mode has
    for (const Mode& other : modes)
      if (other.has(group)) wanted += (wanted.empty() ? "" : " or ") + other.chooser->get_name();
    if (!wanted.empty())
      throw ConfigError("evaluate " + mode.chooser->get_name() + ": " + option->get_name() +
                        " came, expected only with " + wanted);
  }
}

}  // namespace

void add_evaluate(CLI::App& app, CommonFlags& common, std::function<void()>& run) {
  CLI::App* command = add_command(app, common, "evaluate",
                                  "score a surface against the truth, a network on a data set, or "
                                  "a picture or mesh against another");
  static Shared shared;
  static const std::vector<Mode> modes{add_surface(*command, shared), add_data(*command, shared),
                                       add_picture(*command, shared), add_mesh(*command, shared)};
  add_shared(*command, shared);
  for (const Mode& mode : modes)
    for (const Mode& other : modes)
      if (&other != &mode) mode.chooser->excludes(other.chooser);
  command->callback([&run, command] {
    const auto mode = std::ranges::find_if(modes, &Mode::chosen);
    if (mode == modes.end())
      throw CLI::RequiredError(
          "--dsm and --truth, --data, --image and --reference, or --mesh and --reference-mesh");
    refuse_others(*command, modes, *mode);
    if (mode->partner != nullptr && mode->partner->count() == 0)
      throw CLI::RequiredError(mode->partner->get_name());
    run = mode->run;
  });
}

}  // namespace satsurf::app

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/app/log.h"
#include "satsurf/app/output_folder.h"
#include "satsurf/app/progress.h"
#include "satsurf/app/reconstruct_options.h"
#include "satsurf/app/record.h"
#include "satsurf/core/error.h"
#include "satsurf/nn/model.h"
#include "satsurf/nn/surface_net.h"
#include "satsurf/reconstruct/reconstruct.h"
#include "satsurf/reconstruct/warnings.h"
#include "satsurf/rpc/crs.h"
#include "satsurf/rpc/raster.h"
#include "satsurf/scene/user_images.h"

#include <filesystem>
#include <new>
#include <optional>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace satsurf::app {

/// Tells warnings and keeps them for the record.
class Warnings {
 public:
  Warnings(Progress& progress, RunRecord& record) : progress_(progress), record_(record) {}

  void add(const reconstruct::Warning& warning) {
    progress_.note(warning.text, LogLevel::warning);
    record_.add_warning(warning.code, warning.text);
  }
  void add(const std::vector<reconstruct::Warning>& warnings) {
    for (const reconstruct::Warning& warning : warnings) add(warning);
  }
  /// Does a part of the work that the surface can do without: its failure is a warning.
  /// what  of the results it makes; `what` and _failed is the code
  template <class F>
  void attempt(const std::string& what, F&& work) {
    try {
      work();
    } catch (const Error& e) {
      add({what + "_failed", "no " + what + ": " + e.what()});
    } catch (const std::bad_alloc&) {
      add({what + "_failed", "no " + what + ": out of memory; try smaller images"});
    }
  }

 private:
  Progress& progress_;
  RunRecord& record_;
};

/// The networks of one file of weights.
struct Networks {
  nn::Model model;
  std::optional<nn::SurfaceModel> surface;
};

struct SurfaceFacts;

/// A run of `reconstruct`, as both its ways begin and end: images looked at whole, and images worked
/// on in tiles.
struct ReconstructJob {
  const ReconstructCommand& options;
  std::optional<rpc::HeightRange> height_range;  ///< that was asked for
  std::optional<rpc::ProjectedCrs> crs;          ///< of the rasters; none for that of the frame
  double max_memory = 0;                         ///< bytes of the whole program, 0 for any
  std::filesystem::path weights;
  scene::ViewRules rules;
  std::optional<OutputFolder> staged;  ///< empty in a dry run
  RunRecord record;
  Networks networks;
  Progress progress;
  Warnings warnings;

  /// throws  IoError, ConfigError
  explicit ReconstructJob(const ReconstructCommand& options);
  /// How a surface is made, with the progress left to the caller.
  /// frame  of the scene
  reconstruct::ReconstructOptions how(const rpc::LocalFrame& frame) const;
  /// All files that a run reads: weights, shifts, area, and those of the images.
  std::vector<std::filesystem::path> inputs(const scene::Scene& scene) const;
  /// Sees that the rasters' system suits the images; one that is the frame's is forgotten.
  /// throws  ConfigError for one that is made for elsewhere
  void settle_crs(const scene::UserScene& user);
  /// Brings the finished rasters into the system that was asked for.
  /// grid   that they have
  /// facts  of the surface; takes the new system and cells
  /// throws  IoError, Error
  void bring_rasters(const rpc::GeoGrid& grid, SurfaceFacts& facts);
  /// Says what was found in the images, warns of what they let fear, and notes all files.
  void note_scene(const scene::UserScene& user);
};

/// Both ways. They leave the finished folder in its place, or print their plan. Of whole images: false,
/// with nothing said or written, where the surface would take more than --max-memory.
bool reconstruct_whole(ReconstructJob& job);
void reconstruct_tiles(ReconstructJob& job);

/// The first lines of a plan: heights and ground.
/// searched  of the heights, local m
/// crs       of the rasters; none for that of the frame
void print_plan_ground(const scene::UserScene& user, const rpc::HeightRange& searched,
                       const reconstruct::Ground& ground,
                       const std::optional<rpc::ProjectedCrs>& crs);
/// What the time of a run depends on.
struct PlannedWork {
  double megapixels = 0;  ///< that the network sees, of all images
  Index views = 0;        ///< that it sees at once
  double cells = 0;       ///< of the surface, where tiles overlap those of each
  double columns = 0;     ///< of the mesh's voxels, 0 without one
  bool in_tiles = false;
  double so_far = 0;  ///< s that it took to read and compare the images
};
/// The last line of a plan: the time, which is an estimate.
void print_plan_time(const PlannedWork& work);

/// What the record says of every run.
struct SurfaceFacts {
  double completeness = 0, resolution = 0, mean_confidence = 0, camera_fit_max_px = 0;
  double image_correlation = 0;
  std::string crs;  ///< of the rasters
  Index rows = 0, columns = 0, surfels = 0, tiles = 0;
  Index compared = 0, agreed = 0;                        ///< see Reconstruction
  Index levelled = 0, evened = 0;                        ///< cells, those that tiles share in each
  rpc::HeightRange searched;                             ///< heights above the ellipsoid, m
  rpc::HeightRange heights;                              ///< lowest and highest cell, likewise
  nlohmann::ordered_json mesh;                           ///< null without one
  rpc::HeightDatum datum = rpc::HeightDatum::ellipsoid;  ///< of dsm.tif
  double seconds = 0;                                    ///< that making the surface took
  double planned_memory_bytes = 0;
};
nlohmann::json results_json(const SurfaceFacts& facts, const scene::UserScene& user);
/// The last lines on stdout.
void print_summary(const SurfaceFacts& facts, const scene::Scene& scene, double wall_seconds,
                   const std::filesystem::path& out);
/// throws  Error where no cell has a height
[[noreturn]] void refuse_no_heights(const std::vector<std::filesystem::path>& images);
/// throws  Error for a surface with fewer cells than were asked for
void check_coverage(double completeness, const ReconstructCommand& options);

}  // namespace satsurf::app

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/rpc/fit.h"
#include "satsurf/rpc/frame.h"
#include "satsurf/rpc/raster.h"
#include "satsurf/scene/simulate/scene.h"
#include "satsurf/train/mono_trainer.h"
#include "satsurf/train/trainer.h"

#include <filesystem>
#include <optional>
#include <string>
#include <variant>
#include <vector>

namespace satsurf::app {

// The sub-commands of the `satsurf` program. Each does its work, writes results to stdout and
// progress to stderr, and throws Error for anything that stops it; files appear complete or not at
// all.

/// Thrown out of a command that was told to stop, e.g. by Ctrl-C.
struct Interrupted {};

/// From now on the first SIGINT, SIGTERM or SIGHUP is noted and the second of its kind kills; a
/// SIGHUP that nohup has the program ignore stays ignored.
void catch_interrupts();
/// Whether one has come since.
bool interrupted();
/// The signal noted, 0 for none.
int interrupt_signal();

/// What `info` is asked.
struct InfoOptions {
  std::vector<std::filesystem::path> images, image_dirs;
};
/// Size, camera and where it came from, footprint, viewing and sun angles of images; overlap and
/// parallax of pairs; network and origin of weights (.safetensors).
void run_info(const InfoOptions& options);

/// What `simulate` is asked.
struct SimulateOptions {
  std::filesystem::path out, config_file;  ///< config_file may be empty
  scene::SimulateConfig config;
  bool overwrite = false;
};
/// Makes up scenes and writes them in the layout of DFC2019.
void run_simulate(const SimulateOptions& options);

/// What `train` is asked.
struct TrainOptions {
  std::filesystem::path data, out, config_file;  ///< config_file may be empty
  std::variant<train::TrainConfig, train::MonoTrainConfig> config;
  std::uint64_t seed = 0;
  bool overwrite = false, resume = false;
};
/// Trains a network on a data set: which one is in the configuration.
/// throws  Interrupted after saving a checkpoint
void run_train(const TrainOptions& options);

/// What `reconstruct` is asked.
struct ReconstructCommand {
  std::vector<std::filesystem::path> images, image_dirs;
  std::filesystem::path out, weights;  ///< weights may be empty: the shipped ones
  std::optional<rpc::HeightRange> height_range;
  double resolution = 0;  ///< m, 0 for the images' own
  bool mesh = true;       ///< make one
  double voxel = 0;       ///< of the mesh, m; 0 for two pixels on the ground
  bool overwrite = false;
  bool dry_run = false;  ///< only say what would be done; `out` may be empty
};
/// Makes a surface of images: the folder that the README describes.
void run_reconstruct(const ReconstructCommand& options);

/// What `evaluate --dsm` is asked.
struct EvaluateDsmOptions {
  std::filesystem::path dsm, truth, classes, json, picture;  ///< the last three may be empty
  /// Images: only what two of them see is scored; and where else to look for those JSON files name.
  std::vector<std::filesystem::path> seen_by, image_dirs;
  std::string registration = "none";
  bool mask_water = false, overwrite = false;
};
/// Scores one surface against the truth.
void run_evaluate_dsm(const EvaluateDsmOptions& options);

/// What `evaluate --data` is asked.
struct EvaluateDataOptions {
  /// All but the first may be empty.
  std::filesystem::path data, weights, json, csv, lpips_weights, confidence_csv, confidence_figure;
  std::string registration = "none";
  Index views = 3;
  bool mask_water = true, meshes = true, overwrite = false;
};
/// Scores a network on a data set.
void run_evaluate_data(const EvaluateDataOptions& options);

/// What `evaluate --image` is asked.
struct EvaluateImageOptions {
  std::filesystem::path image, reference;
  std::filesystem::path mask, lpips_weights, json;  ///< may be empty
  bool overwrite = false;
};
/// Scores one picture against another.
void run_evaluate_image(const EvaluateImageOptions& options);

/// What `evaluate --mesh` is asked.
struct EvaluateMeshOptions {
  std::filesystem::path mesh, reference, json;  ///< json may be empty
  bool overwrite = false;
};
/// Scores one mesh against another.
void run_evaluate_mesh(const EvaluateMeshOptions& options);

/// What `render` is asked.
struct RenderCommand {
  std::filesystem::path surfels, image, out;  ///< without an image: from straight above
  std::vector<std::filesystem::path> image_dirs;
  double resolution = 0;  ///< of the view from above, m; 0: half a metre
  bool overwrite = false;
};
/// Renders a surfel file into a camera or from above.
void run_render(const RenderCommand& options);

/// The file asked for; else the shipped weights.
/// throws  IoError as nn::shipped_weights
std::filesystem::path find_weights(const std::filesystem::path& asked);

/// The frame of a surfel or mesh file, as comment lines of its header.
std::vector<std::string> frame_comments(const rpc::LocalFrame& frame);
/// The inverse of `frame_comments`.
/// where   begins the error text
/// throws  IoError if the lines do not name a frame
rpc::LocalFrame frame_from_comments(const std::vector<std::string>& comments,
                                    const std::string& where);

/// Writes a GeoTIFF of what is known on the grid of a local field.
/// values  [H W], NaN where unknown
/// offset  added to every value: the frame's `h0` makes local heights ellipsoidal
/// throws  IoError
void write_field(const std::filesystem::path& path, const Tensor& values,
                 const scene::HeightField& grid, const rpc::LocalFrame& frame, double offset,
                 const rpc::GeoTags& tags);

}  // namespace satsurf::app

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/evaluate/causes.h"
#include "satsurf/evaluate/confidence.h"
#include "satsurf/evaluate/image_metrics.h"
#include "satsurf/evaluate/metrics.h"
#include "satsurf/mesh/compare.h"
#include "satsurf/nn/input.h"
#include "satsurf/nn/model.h"
#include "satsurf/reconstruct/plan.h"
#include "satsurf/rpc/raster.h"
#include "satsurf/scene/scene.h"

#include <array>
#include <filesystem>
#include <functional>
#include <limits>
#include <optional>
#include <string>
#include <vector>

namespace satsurf::evaluate {

/// Where a class raster does not say water (class 9 of DFC2019).
/// classes  [H W] on the truth's grid
/// returns  [H W], 1 or 0
Tensor not_water(const Tensor& classes);

/// A camera and the size of its image.
struct ImageCamera {
  rpc::Rpc rpc;
  Index width = 0, height = 0;
};
/// Where the true surface lies inside at least two of the images: what a reconstruction from them
/// can be asked for. Hidden ground counts.
/// truth    heights in `frame`
/// images   the cameras
/// returns  [H W] on the truth's grid, 1 or 0
Tensor seen_by_two(const scene::HeightField& truth, const rpc::LocalFrame& frame,
                   const std::vector<ImageCamera>& images);

/// Share of an image's valid pixels in which a rendered one shows more surface than background.
/// alpha    [H W] of the rendered image; 0.5 is enough
/// valid    [H W], > 0 where the image has data
/// returns  NaN if it has none
/// throws   ShapeError
double covered_share(const Tensor& alpha, const Tensor& valid);

/// A surface against the true one, as meshes: fused of the heights that either shows in images of
/// the place, above the cells that count.
/// truth    the true surface
/// images   whole, with their cameras, in the frame of both surfaces
/// mask     [H W] on the truth's grid, > 0 where a cell counts
/// shift    added to the surfels' mesh: east, north, up, m; its cells are those it then lies above
/// voxel    of both meshes, m
/// returns  nothing where one of them has no surface
std::optional<mesh::MeshComparison> compare_surfaces(const splat::Surfels& surfels,
                                                     const scene::HeightField& truth,
                                                     const std::vector<nn::PosedImage>& images,
                                                     const Tensor& mask,
                                                     const std::array<double, 3>& shift,
                                                     double voxel);

/// Two height rasters put into one metric frame: the truth's, minus its rounded corner.
struct DsmPair {
  scene::HeightField prediction, truth;
  double east = 0, north = 0;  ///< that corner, m: what is added to x and y of both
  int epsg = 0;                ///< of the system of both; 0 if neither names one
  /// With h0 = 0; none if neither raster is known to be in a UTM zone.
  std::optional<rpc::LocalFrame> frame;

  /// Where the cells of a field of the pair lie in its system.
  rpc::GeoGrid geo_grid(const scene::HeightField& field) const {
    return {epsg, field.x0 + east, field.y0 + north, field.step};
  }
};
/// A raster without a known system is taken to be in the other's (DFC2019's truth has none).
/// throws  IoError if both are known and differ
DsmPair load_dsm_pair(const std::filesystem::path& prediction, const std::filesystem::path& truth);

/// How a network is scored on a data set.
struct EvaluateOptions {
  Index views = 3;  ///< sources; the scene's next view, if there is one, is the rendered target
  /// Side of the window around the truth's middle in which views are scored, px at most: the
  /// network looks at as much of the sources, and as much of the target is rendered.
  Index window = 512;
  Registration registration = Registration::none;
  reconstruct::Surface surface = reconstruct::Surface::automatic;
  const nn::SurfaceModel* network = nullptr;  ///< as in ReconstructOptions
  double range_above = 0;  ///< added to the upper end of the height range of a reconstruction, m
  bool mask_water = true;  ///< leave out cells of class 9
  bool meshes = true;      ///< also compare meshes, which takes a few seconds per scene
  const nn::Lpips* lpips = nullptr;  ///< scores rendered targets too, if given
  std::function<void(const std::string& stage, double fraction)> progress;  ///< may be empty
};

/// A DSM after one registration.
struct RegisteredScores {
  HeightScores scores;
  /// With its holes filled on the truth's grid after registering, see `filled`.
  HeightScores filled;
  std::array<double, 3> shift{0, 0, 0};  ///< added to the prediction: east, north, up, m
};

/// How true the expected errors of a surface are: the shares of the compared cells whose error is
/// within one and two of them, 68 and 95 % where they are right; NaN of a surface without any.
struct SigmaScore {
  double within_1 = std::numeric_limits<double>::quiet_NaN();
  double within_2 = std::numeric_limits<double>::quiet_NaN();
};
/// sigma, error  [H W] m, NaN where unknown
/// throws        ShapeError
SigmaScore score_sigma(const Tensor& sigma, const Tensor& error);

/// All numbers of one scene. What needs a target view is NaN without one, its counts 0. Of views
/// only a window counts, see EvaluateOptions.
struct SceneScores {
  std::string name;
  /// The reconstructed DSM against the truth, registered as asked; without its rasters, which are
  /// many over a data set. Where nothing was reconstructed every cell is missing.
  DsmComparison dsm;
  std::array<RegisteredScores, 3> registered;  ///< the same by each Registration: none, z, xyz
  /// Errors by cause: of the DSM registered as asked, its holes filled.
  CauseScores causes;
  SigmaScore sigma;    ///< of the DSM registered as asked, not filled
  OracleScore oracle;  ///< the best choice among the surfels that make the DSM
  /// See `lost_by_stage`, in the window in which views are scored.
  std::array<double, 2> lost{CauseScore::kNone, CauseScore::kNone};
  HeightScores mvs_source;  ///< last-stage network heights of the source views, all pixels pooled
  double mvs_source_rmse_per_view = 0;  ///< the same RMSE view by view, then averaged, m
  HeightScores render_target;           ///< heights rendered in the target view
  ImageScores target;  ///< colours rendered there, where they are opaque and the image is valid
  double target_covered = 0;  ///< see `covered_share`: how much of the image these scores are of
  /// See `compare_surfaces`; registered as asked, above the cells that the DSM is scored on.
  std::optional<mesh::MeshComparison> mesh;
  double seconds = 0;  ///< of the reconstruction, without reading files
};

/// The confidence figure's numbers, over all scenes.
struct ConfidenceScores {
  ConfidenceErrors mvs_source;  ///< last-stage heights and confidences of the source views
  ConfidenceErrors dsm;         ///< DSM cells, registered as asked, and rendered confidences
};

/// All numbers of a data set.
struct DataScores {
  std::vector<SceneScores> scenes;
  ConfidenceScores confidence;
};

/// Reconstructs a scene from its first views and scores everything the field's tables hold. The
/// height range is the scene's own, as in the protocols of the field; true cells count where two of
/// these views see them.
/// confidence  the scene's pixels are added to it, unless nullptr
/// throws      IoError if the scene has too few views, no truth that counts, or is too small for
///             LPIPS
SceneScores evaluate_scene(const nn::Model& model, const scene::Scene& scene,
                           const EvaluateOptions& options, ConfidenceScores* confidence = nullptr);

/// Every scene of a data set, see `list_scenes`. One of which nothing could be reconstructed counts
/// as all missing.
/// throws  IoError as above; Error naming the scene
DataScores evaluate_data(const nn::Model& model, const std::filesystem::path& folder,
                         const EvaluateOptions& options);

}  // namespace satsurf::evaluate

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/model.h"
#include "satsurf/rpc/raster.h"
#include "satsurf/train/dataset.h"
#include "satsurf/train/metrics.h"

#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace satsurf::train {

/// The scores by name; null for a number that does not exist.
nlohmann::ordered_json scores_json(const HeightScores& scores);
/// Scores before and after registration, and the shift.
nlohmann::ordered_json scores_json(const DsmComparison& comparison);

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
Tensor seen_by_two(const HeightField& truth, const rpc::LocalFrame& frame,
                   const std::vector<ImageCamera>& images);

/// Two height rasters put into one metric frame: the truth's, minus its rounded corner.
struct DsmPair {
  HeightField prediction, truth;
  /// With h0 = 0; none if neither raster is known to be in a UTM zone.
  std::optional<rpc::LocalFrame> frame;
};
/// A raster without a known system is taken to be in the other's (DFC2019's truth has none).
/// throws  IoError if both are known and differ
DsmPair load_dsm_pair(const std::filesystem::path& prediction, const std::filesystem::path& truth);

/// How a network is scored on a data set.
struct EvaluateOptions {
  Index views = 3;     ///< sources; the scene's next view, if there is one, is the rendered target
  Index window = 512;  ///< side of the window in which heights in views are scored, px at most
  Registration registration = Registration::none;
  bool mask_water = true;  ///< leave out cells of class 9
  std::function<void(const std::string& stage, double fraction)> progress;  ///< may be empty
};

/// All numbers of one scene.
struct SceneScores {
  std::string name;
  DsmComparison dsm;           ///< the reconstructed DSM against the truth
  HeightScores mvs_source;     ///< last-stage network heights of the source views
  HeightScores render_target;  ///< heights rendered in the target view; `truth` is 0 without one
  double target_psnr = 0;      ///< of the rendered target, dB; NaN without one
  double seconds = 0;          ///< of the reconstruction, without reading files
};

/// Reconstructs a scene from its first views and scores everything the field's tables hold. The
/// height range is the scene's own, as in the protocols of the field; true cells count where two of
/// these views see them.
/// throws  IoError if the scene has too few views or no truth
SceneScores evaluate_scene(const nn::Model& model, const Scene& scene,
                           const EvaluateOptions& options);

/// Every scene of a data set, see `list_scenes`.
/// throws  IoError as above
std::vector<SceneScores> evaluate_data(const nn::Model& model, const std::filesystem::path& folder,
                                       const EvaluateOptions& options);

/// {"scenes": [...], "mean": {...}}: the mean is taken over scenes, not over cells, and leaves out
/// scenes for which a number does not exist.
nlohmann::ordered_json scores_json(const std::vector<SceneScores>& scores);
/// The same as one CSV row per scene and a last row `mean`.
std::string scores_csv(const std::vector<SceneScores>& scores);

}  // namespace satsurf::train

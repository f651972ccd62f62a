// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/rpc/ground_raster.h"
#include "satsurf/rpc/read.h"
#include "satsurf/scene/pointing.h"
#include "satsurf/scene/scene.h"
#include "satsurf/scene/validity.h"
#include "satsurf/scene/view_choice.h"

#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace satsurf::scene {

/// What is known of the surface's height before the images have been compared.
struct RangeChoice {
  rpc::HeightRange height_range;  ///< m above the ellipsoid
  std::string source;             ///< in words: where it came from
  std::string trouble{};          ///< in words: why a model of the terrain was no help; or empty
  bool found = false;             ///< by comparing the images
};

/// throws  ConfigError for a wanted range that holds no surface: reversed, or of less than a metre
void check_height_range(const rpc::HeightRange& wanted);

/// What is done about cameras that do not agree with one another.
struct PointingChoice {
  bool measure = true;                 ///< and correct, if that is worth it; see `measure_pointing`
  bool affine = false;                 ///< whether shifts may change within an image
  std::optional<NamedShifts> given{};  ///< instead of an estimate
};

/// A scene of a user's own images.
struct UserScene {
  Scene scene;
  RangeChoice range;
  std::optional<Pointing> pointing{};  ///< nothing where it was not asked for
  std::vector<LeftOut> left_out{};     ///< images that are no views of the scene
};

/// Views of a scene unless more are wanted: what each tells beside the others becomes less, and the
/// time grows with the square of their number.
inline constexpr Index kMostViews = 5;

/// Views of a scene whose parts have their own, at most: each is kept as a copy, and every two that
/// overlap are compared for the pointing.
inline constexpr Index kMostSurveyed = 16;

/// What is made of images before anything is searched in them.
struct ViewRules {
  ValidityRules validity{};       ///< what of every image does not count
  PointingChoice pointing{};      ///< whether cameras are measured and shifted
  Index most_views = kMostViews;  ///< that the scene is made of; the best, see `choose_views`
  /// Whether all views are looked at at once, or each part of the ground has its own.
  Together together = Together::all;
  /// Ground whose heights do not count when the range is searched for; none for all ground.
  std::shared_ptr<const rpc::GroundMask> mask{};
  /// That says the range of heights, see `terrain_range`; none for no such model.
  std::shared_ptr<const rpc::Terrain> terrain{};
};

/// Views gathered one by one, with what their images say of heights.
class ViewList {
 public:
  explicit ViewList(const ViewRules& rules = {}) : rules_(rules) {}
  /// Adds an image after a check that something can be found again in it.
  /// name    of the view, numbered where it is taken
  /// file    what it was read from; empty for an image in memory
  /// throws  IoError naming the image
  void add(const rpc::Image& image, const std::string& name, const std::filesystem::path& file);
  /// Chooses the views of three images and more, see `choose_views`, checks that each pair sees
  /// common ground, and chooses the frame (UTM zone and rounded centre of the common ground, height
  /// origin in the middle of the height range). Cameras are measured and shifted, if that is wanted,
  /// before any height is searched for. A range of the images' metadata that does not hold the
  /// heights that shifted cameras see is searched for too: the shifts leave open where the ground
  /// as a whole lies.
  /// wanted  height range; else that of the rules' terrain over the common ground, else the one the
  ///         images' metadata name, else it is searched for with `find_height_range`
  /// poll    called often, may throw to stop
  /// throws  ConfigError for a wanted range that is not the cameras', Error for fewer than two
  ///         views or views without overlap or parallax, each naming them
  UserScene scene(const std::optional<rpc::HeightRange>& wanted,
                  const std::function<void()>& poll) &&;

 private:
  ViewRules rules_;
  std::vector<View> views_;
  std::optional<rpc::HeightRange> named_;  // union of the ranges the images name
};

/// Why the range that the rules' terrain said does not hold the heights at which the images see their
/// tie points, in words; nothing where it does, where something else said it, or without ties.
std::string terrain_contradicted(const ViewRules& rules, const UserScene& user);

/// Opens every view once and makes a scene of them, see `ViewList`.
/// files       two or more images or Sat-NeRF JSON files
/// image_dirs  where else to look for the images that JSON files name
/// wanted      height range, m above the ellipsoid
/// poll        called often, may throw to stop
/// rules       what of every image does not count, and what becomes of the cameras
/// throws      IoError for a file that cannot be used (missing, too small, without texture); see
///             `ViewList` for others
UserScene scene_from_views(const std::vector<std::filesystem::path>& files,
                           const std::vector<std::filesystem::path>& image_dirs,
                           const std::optional<rpc::HeightRange>& wanted,
                           const std::function<void()>& poll = {}, const ViewRules& rules = {});

}  // namespace satsurf::scene

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/scene/pointing_adjustment.h"
#include "satsurf/scene/scene.h"

#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

namespace satsurf::scene {

/// How well the cameras of a scene agree, and shifts that make them agree better.
struct Pointing {
  std::vector<std::string> names;    ///< of the views
  std::vector<std::string> marks{};  ///< of their cameras as they came, see `camera_mark`; or empty
  std::vector<rpc::Pixel> shifts;    ///< to add to where each camera sees a point, px; mean zero
  std::vector<rpc::ShiftSlope> slopes{};  ///< what these change by within the images; or empty
  std::vector<PairResidual> before;       ///< every pair with the cameras as they came
  std::vector<PairResidual> after;        ///< with the shifts; empty where none could be estimated
  Index observable = 0;                   ///< see PointingAdjustment
  /// Combinations of the shifts that the tie points ought to determine and do not: of N images that
  /// they connect 2 N - 3, of shifts with slopes not counted.
  Index undetermined = 0;
  std::vector<std::size_t> unconnected{};  ///< views whose camera the tie points say nothing of
  bool applied = false;                    ///< whether the scene's cameras have been shifted
  std::string verdict;                     ///< in words: why, or why not
  /// Middle nine tenths of the tie points' heights with the shifts, m above the ellipsoid; empty
  /// without any.
  std::optional<rpc::HeightRange> heights;

  double largest_shift = 0;  ///< its length, px; of shifts with slopes that at a tie point
  rpc::ShiftSlope slope(std::size_t view) const {
    return slopes.empty() ? rpc::ShiftSlope{} : slopes[view];
  }
};

/// Tie points that make a pair of images believable.
inline constexpr Index kFewestTies = 20;
/// Largest error of an image's pointing that is found, px.
inline constexpr double kLargestPointingError = 50;

/// Measures how well cameras agree and estimates a shift for each, without changing anything.
///   measured   with tie points, see `find_tie_points`
///   estimated  with `adjust_pointing`, for the most images that pairs with 20 points or more
///              connect; the others' cameras stay as they are, and the verdict names them
///   useful     (`applied` is then set) where the largest shift is above 0.3 px and the residuals
///              across the epipolar direction become smaller
/// views         two or more
/// height_range  heights of the ground, m above the ellipsoid; may be wide
/// poll          called often, may throw to stop
/// affine        whether shifts may change within an image
Pointing measure_pointing(const std::vector<View>& views, const rpc::HeightRange& height_range,
                          const std::function<void()>& poll = {}, bool affine = false);

/// The same of tie points that have been found, in views whose pixels are not needed.
/// height  where points are begun, m above the ellipsoid
Pointing pointing_from(const std::vector<View>& views, const std::vector<TiePoint>& points,
                       double height, bool affine = false);

/// A shift that is known, and what it changes by within the image.
struct KnownShift {
  rpc::Pixel shift;
  rpc::ShiftSlope slope{};
  std::string mark{};  ///< of the camera it was found for, see `camera_mark`; empty where not known
};
/// Shifts by the names of the images, as a file of them says.
using NamedShifts = std::map<std::string, KnownShift>;

/// What tells a camera from others, whatever its image is called: 16 hexadecimal digits that are the
/// same for the same numbers.
std::string camera_mark(const rpc::Rpc& camera);

/// The same with shifts that are known. `applied` is set.
/// throws  ConfigError naming a view without a shift
Pointing given_pointing(const std::vector<View>& views, const NamedShifts& shifts,
                        const rpc::HeightRange& height_range,
                        const std::function<void()>& poll = {});

/// The shift of each view: the one found for its camera, else the one of its name.
/// throws  ConfigError naming a view without one, or one whose camera cannot have its slopes
std::vector<KnownShift> shifts_of(const std::vector<View>& views, const NamedShifts& shifts);
/// As `given_pointing`, of tie points that have been found.
Pointing given_pointing(const std::vector<View>& views, const std::vector<KnownShift>& shifts,
                        const std::vector<TiePoint>& points, double height);

/// Shifts the cameras of the views, see `Rpc::corrected`.
void apply_pointing(const Pointing& pointing, std::vector<View>& views);

/// One number for all pairs: the mean of their residuals across the epipolar direction, each with
/// the weight of its points, px; nothing without points.
std::optional<double> mean_across(const std::vector<PairResidual>& pairs);

}  // namespace satsurf::scene

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/scene/polygon.h"
#include "satsurf/scene/user_images.h"

#include <cstddef>
#include <filesystem>
#include <functional>
#include <optional>
#include <vector>

namespace satsurf::scene {

/// An image that is read in windows, and what has to be known of it as a whole.
struct SurveyedView {
  rpc::ViewSource source;
  Index width = 0, height = 0;  ///< of the whole image, px
  rpc::Rpc rpc;                 ///< of the whole image, shifted as `Survey::user.pointing` says
  rpc::RgbChoice colours{};     ///< the same for all windows
  Tensor border{};  ///< [h w] of the reduced copy, 1 on its border (`border_of`); empty without one
  std::vector<std::vector<float>> border_values{};  ///< what its pixels have, channel by channel
};

/// Images too large to be read whole, looked at once.
struct Survey {
  UserScene user;                   ///< of the reduced copies
  std::vector<SurveyedView> views;  ///< the same, in the same order
  Index factor = 1;                 ///< by which the copies are smaller, for all views
  std::vector<double> nodata;       ///< values that say nothing
  bool colour = false;              ///< whether any image has three bands
  Index most_views = kMostViews;    ///< of a part of the ground
};

/// Reads of every image a copy of at most 2048 px a side and makes of these what
/// `scene_from_views` makes of whole images: borders, stretch, overlaps, frame and height range. The
/// cameras' pointing is measured where pixels are whole, in up to nine windows of 1536 px spread
/// over the common ground; in the images themselves where these are no larger than the copies.
/// rules   their most views are those of a part of the ground; of all together there are at most
///         `kMostSurveyed`, each of which sees ground of another
/// throws  as `scene_from_views`
Survey survey_views(const std::vector<std::filesystem::path>& files,
                    const std::vector<std::filesystem::path>& image_dirs,
                    const std::optional<rpc::HeightRange>& wanted,
                    const std::function<void()>& poll = {}, const ViewRules& rules = {});

/// The columns and rows of an image that show some ground, and a few more; nothing where those are
/// fewer than 16 either way.
/// ground   local m
/// z_range  of its heights, local m
std::optional<rpc::PixelWindow> window_of(const SurveyedView& view, const rpc::LocalFrame& frame,
                                          const Polygon& ground, const rpc::HeightRange& z_range);

/// A part of a scene: the views that show something of some ground, each as far as it does.
struct WindowedScene {
  Scene scene;                     ///< in the frame of the whole
  std::vector<std::size_t> views;  ///< their numbers in the survey
  /// Of each the pixels as they are stored, [3 h w], or [1 h w] where all images are grey: those
  /// that became colours.
  std::vector<Tensor> values;
};
/// The views of a part of the ground: those that show something of it where there are no more than
/// the survey's most, else the best of them by `choose_for_ground`.
/// returns  their numbers, ascending
std::vector<std::size_t> views_of(const Survey& survey, const Polygon& ground,
                                  const rpc::HeightRange& z_range);
/// Reads it. Views that are none of `views_of`, or whose window has no valid pixel are left out, so there may be none.
/// throws  IoError
WindowedScene read_windows(const Survey& survey, const Polygon& ground,
                           const rpc::HeightRange& z_range);

}  // namespace satsurf::scene

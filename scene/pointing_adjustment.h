// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/rpc/model.h"
#include "satsurf/scene/tie_points.h"

#include <cstddef>
#include <optional>
#include <vector>

namespace satsurf::scene {

/// How two images agree on the ground points they share, in pixels of the later one: medians of
/// absolute distances.
struct PairResidual {
  std::size_t a = 0, b = 0;  ///< a < b
  Index ties = 0;            ///< how many points
  double across = 0;         ///< across the epipolar direction; 0 without points
  /// Along it: against the height that all images give a point. Two images say nothing of it, so
  /// only points in three or more count; nothing without any.
  std::optional<double> along;
};

/// What tie points say of cameras.
struct TieResiduals {
  std::vector<PairResidual> pairs;  ///< every pair, in order, those without a common point included
  std::vector<double> heights;      ///< of the points, m above the ellipsoid
};

/// Puts every point where its rays meet best and measures by how much they miss each other.
/// cameras  of the images
/// shifts   added to where each camera sees a point, px, one for each of them
/// points   `view` of a sighting numbers the cameras
/// height   where points are begun, m above the ellipsoid
TieResiduals tie_residuals(const std::vector<rpc::Rpc>& cameras,
                           const std::vector<rpc::Pixel>& shifts,
                           const std::vector<TiePoint>& points, double height);

/// Shifts of several images that make their rays meet.
struct PointingAdjustment {
  std::vector<rpc::Pixel> shifts;       ///< to add to where each camera sees a point, px; see below
  std::vector<rpc::ShiftSlope> slopes;  ///< what they change by within the images; or empty
  Index observable = 0;                 ///< combinations of these that the points determine
};

/// One shift for each image, from all tie points together: least squares over shifts and ground
/// points in which far-off sightings lose their weight (Cauchy, iterated).
///   minimise  sum_k sum_i  w_ki | u_ki - project_i(P_k) - s_i |^2   with   sum_i A_i^-1 s_i = 0
/// and A_i = d project_i / d(east, north) in the middle of the points. What these do not determine
/// stays zero: moving all of the ground moves every image, and the mean of the displacements that
/// the shifts mean on the ground is the horizontal part of that; lifting it moves them along their
/// epipolar directions, and of two images the whole shift along that direction is such a lift.
/// With `affine`, s_i is a shift and a slope, so that it changes linearly within an image; then the
/// mean displacement is that in the middle, and the ground's own slopes and scales stay, too.
/// cameras, points, height  as in `tie_residuals`; each camera sees some of the points
/// throws                   Error without points
PointingAdjustment adjust_pointing(const std::vector<rpc::Rpc>& cameras,
                                   const std::vector<TiePoint>& points, double height,
                                   bool affine = false);

}  // namespace satsurf::scene

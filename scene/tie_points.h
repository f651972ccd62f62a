// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/scene/scene.h"

#include <cstddef>
#include <functional>
#include <vector>

namespace satsurf::scene {

/// Where one ground point shows in one of several images.
struct Sighting {
  std::size_t view = 0;  ///< which image
  rpc::Pixel pixel;
};

/// One ground point, seen in two or more images, each at most once.
struct TiePoint {
  std::vector<Sighting> sightings;  ///< by ascending view
};

/// Ground points that the images show, found without trusting the cameras' pointing: corners spread
/// over every image are looked for in each later one by normalised correlation, on pyramids from
/// coarse to fine. At the coarsest level all heights of the range and all shifts across the epipolar
/// direction are tried, and the shift is the one that suits the corners of a pair together. Matches
/// that do not lead back, or disagree with their pair across the epipolar direction, are left out;
/// a pair that does not overlap, or shows nothing in common, has none.
/// views       two or more
/// height_range  heights of the ground, m above the ellipsoid; may be wide
/// largest_px  error of one image's pointing up to which points are found, px
/// poll        called between pairs, may throw to stop
/// returns     points in the order of their first image
std::vector<TiePoint> find_tie_points(const std::vector<View>& views,
                                      const rpc::HeightRange& height_range, double largest_px,
                                      const std::function<void()>& poll = {});

}  // namespace satsurf::scene

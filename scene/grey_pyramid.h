// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/scene/scene.h"

#include <array>
#include <cmath>
#include <vector>

namespace satsurf::scene {

/// One grey image; NaN where nothing is known, which every sum over a window then is as well.
struct Grey {
  Index height = 0, width = 0;
  std::vector<float> values{};  ///< row by row

  const float* row(Index y) const { return values.data() + y * width; }
  float* row(Index y) { return values.data() + y * width; }
  /// Bilinear; NaN beyond the image.
  float at(double x, double y) const {
    const double left = std::floor(x), top = std::floor(y);
    if (!(left >= 0 && top >= 0 && left + 1 < static_cast<double>(width) &&
          top + 1 < static_cast<double>(height)))
      return std::nanf("");
    const float* p = row(static_cast<Index>(top)) + static_cast<Index>(left);
    const auto fx = static_cast<float>(x - left), fy = static_cast<float>(y - top);
    return (1 - fy) * ((1 - fx) * p[0] + fx * p[1]) +
           fy * ((1 - fx) * p[width] + fx * p[width + 1]);
  }
};

/// An image and its halves: level l has pixels 2^l as wide, centred at (x + 0.5) / 2^l - 0.5.
/// levels   how many, 1 or more
/// returns  the mean of the colours and its block means, finest first
std::vector<Grey> grey_pyramid(const View& view, Index levels);

/// Points that can be found again: in each square cell the place whose window changes most in every
/// direction (the smaller eigenvalue of the gradients' second moments), where it changes at all.
/// Source: Shi and Tomasi 1994.
/// image    to look in
/// cell     side of a cell, px
/// border   kept free, px
/// returns  x, y in px, row by row
std::vector<std::array<double, 2>> spread_corners(const Grey& image, Index cell, Index border);

}  // namespace satsurf::scene

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/tensor.h"

#include <array>
#include <filesystem>
#include <string>
#include <vector>

namespace satsurf::app {

// Pictures for people: [3 H W] in [0, 1], neutral grey where nothing is known.
// Maps come in as [H W] with NaN where unknown.

/// What the colours of a picture stand for.
struct ColourScale {
  std::string title;                          ///< what the numbers are, with their unit
  double low = 0, high = 1;                   ///< that the first and the last colour stand for
  bool below = false, above = false;          ///< whether these stand for what lies beyond, too
  std::vector<std::array<float, 3>> colours;  ///< evenly spaced, sRGB in [0, 1]
};

/// Of `height_picture`.
/// z   heights, m
/// h0  added to the numbers: with the frame's they are above the ellipsoid
ColourScale height_scale(const Tensor& z, double h0);
/// Of `confidence_picture`.
ColourScale confidence_scale();
/// Of `sigma_picture`.
ColourScale sigma_scale(const Tensor& sigma);
/// Of `count_picture`: the colour of each count from none to `most`.
std::vector<std::array<float, 3>> count_colours(Index most);
/// Of `error_picture`.
ColourScale error_scale(double limit = 5);

/// The means of what is known in square blocks of cells, the last ones of what is left.
/// values  [H W] or [C H W], NaN where unknown
Tensor block_means(const Tensor& values, Index block);
/// A picture of any brightness made legible: the 1st percentile of its values becomes black and the
/// 99th white, alike in all channels.
/// picture  [3 H W] in [0, 1], NaN where unknown
Tensor stretched_picture(const Tensor& picture);
/// Heights through a perceptually even colour map, dark low and bright high, stretched from the 2nd
/// to the 98th percentile.
Tensor height_picture(const Tensor& z);
/// The surface lit from the north-west, 45 degrees high.
/// Source: Horn 1981 (slope from 3 x 3 cells).
/// z     heights, m
/// step  cell size, m
Tensor hillshade_picture(const Tensor& z, double step);
/// [0, 1] from dark to bright.
Tensor confidence_picture(const Tensor& confidence);
/// Expected errors from 0, dark, to their 98th percentile, bright.
/// sigma  m
Tensor sigma_picture(const Tensor& sigma);
/// How many images see a cell, from none, dark, to `most`, bright.
Tensor count_picture(const Tensor& views, Index most);
/// Blue where the prediction is too low, white where it is right, red where it is too high.
/// error  prediction - truth, m
/// limit  error at which the colour saturates, m
Tensor error_picture(const Tensor& error, double limit = 5);

/// A picture as the bytes of an 8-bit PNG; values outside [0, 1] are clipped, NaN becomes grey.
/// picture  [3 H W] or [H W] in [0, 1]
/// throws   IoError, ShapeError
std::string png_bytes(const Tensor& picture);
/// The same as a JPEG of high quality.
std::string jpeg_bytes(const Tensor& picture);

/// Writes an 8-bit PNG; values outside [0, 1] are clipped, NaN becomes grey. The old file or the
/// new one is left, never half.
/// picture  [3 H W] or [H W] in [0, 1]
/// throws   IoError
void write_png(const std::filesystem::path& path, const Tensor& picture);

}  // namespace satsurf::app

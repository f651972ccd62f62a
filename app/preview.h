// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/tensor.h"

#include <filesystem>

namespace satsurf::app {

// Pictures for people: [3 H W] in [0, 1], neutral grey where nothing is known.
// Maps come in as [H W] with NaN where unknown.

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
/// Blue where the prediction is too low, white where it is right, red where it is too high.
/// error  prediction - truth, m
/// limit  error at which the colour saturates, m
Tensor error_picture(const Tensor& error, double limit = 5);

/// Writes an 8-bit PNG; values outside [0, 1] are clipped, NaN becomes grey. The old file or the
/// new one is left, never half.
/// picture  [3 H W] or [H W] in [0, 1]
/// throws   IoError
void write_png(const std::filesystem::path& path, const Tensor& picture);

}  // namespace satsurf::app

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/tensor.h"

#include <vector>

namespace satsurf::scene {

/// What of an image does not count, besides what its file declares.
struct ValidityRules {
  /// A pixel that has one of these values, the same in all channels, says nothing.
  std::vector<double> nodata{};
  /// Neither does one of a border, see `border_of`.
  bool borders = true;
};

/// The filling around an image that was turned, cut or warped without nodata being declared: pixels
/// of one value, zero or another, in all channels, joined side by side to the rim of the image. Such
/// a patch counts as a border where it has 64 pixels or more and holds a corner of the image or a
/// quarter of one of its sides; a dark roof that is cut by the rim does neither.
/// pixels   [C H W]
/// valid    [H W], 0 where a pixel is known to say nothing
/// returns  [H W] 1 on the border, else 0; 0 everywhere for an image of one value
/// throws   ShapeError
Tensor border_of(const Tensor& pixels, const Tensor& valid);

/// What is left of the valid pixels of an image.
struct Validity {
  Tensor valid;       ///< [H W] 1 or 0
  double border = 0;  ///< share of all pixels that are a border nobody had declared
};
/// Applies the rules, the declared value before the border is looked for.
/// pixels, valid  as `border_of`
Validity apply(const ValidityRules& rules, const Tensor& pixels, const Tensor& valid);

}  // namespace satsurf::scene

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/quadratic.h"
#include "satsurf/core/tensor.h"
#include "satsurf/rpc/height_range.h"

#include <vector>

namespace satsurf::nn {

/// One image window with its camera, in the local frame of the scene (x east, y north, z up, m).
struct PosedImage {
  Tensor rgb;                  ///< [3 H W] in [0, 1]
  Tensor valid;                ///< [H W] 1 where the image has data, else 0
  Quadratic local_from_pixel;  ///< (x px, y px, z m) -> (x, y) m
  Quadratic pixel_from_local;  ///< (x, y, z) m -> px
};

/// An image by its own mean and deviation over the valid pixels of all channels, for dates differ in
/// radiometry: what every network sees. Invalid pixels become 0, and an image without contrast stays
/// near 0 instead of amplifying its noise.
/// returns  [1 3 H W]
template <class T>
BasicTensor<T> standardised(const PosedImage& view);

/// What 0 becomes in a standardised image.
double standardised_black(const PosedImage& view);

/// Brightness against its surroundings, which neither gain, offset nor a shadow's edge far away
/// change: the mean of the channels minus its mean over the valid pixels of a window of 15 x 15,
/// by their deviation and 0.01, within [-4, 4]. Invalid pixels become 0.
/// returns  [1 1 H W]
template <class T>
BasicTensor<T> locally_normalised(const PosedImage& view);

/// What the network is given: source views of one size, and the pixel transfer between any two of
/// them.
struct NetworkInput {
  std::vector<PosedImage> sources;  ///< two or more, H and W multiples of `size_multiple`
  /// [reference][source]: (x, y, z) -> px; the diagonal is unused.
  std::vector<std::vector<Quadratic>> transfer;
  rpc::HeightRange z_range;  ///< that is searched, local m
};

}  // namespace satsurf::nn

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/quadratic.h"
#include "satsurf/core/tensor.h"

namespace satsurf {

/// A window of an image, px: columns x0 to x1 and rows y0 to y1, the last of each left out.
struct PixelBox {
  Index x0 = 0, y0 = 0, x1 = 0, y1 = 0;

  Index height() const { return y1 - y0; }
  Index width() const { return x1 - x0; }
};

/// An image to be compared.
struct MaskedGrey {
  Tensor grey,  ///< [H W] finite
      valid;    ///< [H W] 1 where the pixel counts, less where it does not

  Index height() const { return grey.dim(0); }
  Index width() const { return grey.dim(1); }
};

/// Windows that `window_correlation` compares.
struct ComparedWindow {
  static constexpr Index kRadius = 3;                                      ///< px, half a side
  static constexpr Index kPixels = (2 * kRadius + 1) * (2 * kRadius + 1);  ///< of a window
  static constexpr float kWhole = 0.9f * static_cast<float>(kPixels);  ///< the least that both show
  static constexpr float kTexture = 1e-5f;  ///< variance of a window that is not flat
};

/// Normalised correlation of the window around each pixel of a box with another image that is brought
/// onto it, bilinearly, by the map of one height. A pixel counts that is valid, and valid above and to
/// the left of where it lies in the other image. Not differentiable.
/// box       of `a`, at whose border windows are cut
/// b_from_a  (x, y, z) -> (x, y), px and m
/// z         the height, m
/// returns   [box.height() box.width()] -1 to 1; -1 where fewer than `kWhole` pixels count or a window
///           is flat
Tensor window_correlation(const MaskedGrey& a, const MaskedGrey& b, const Quadratic& b_from_a,
                          const PixelBox& box, double z);

/// Products of one window with `count` windows of an image side by side: out[k] is the sum of
/// weights[v side + u] image[v stride + u + k] over all v, u below `side`; NaN where a pixel is.
/// image   the upper left pixel of the first
/// stride  from one row of the image to the next
void window_products(const float* weights, Index side, const float* image, Index stride,
                     Index count, float* out);

}  // namespace satsurf

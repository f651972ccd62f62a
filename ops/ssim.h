// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/var.h"

namespace satsurf {

/// The two conventions results are published in. Both weigh an 11 x 11 window by a Gaussian of
/// sigma 1.5 px.
enum class SsimKind {
  /// scikit-image's structural_similarity with gaussian_weights, sigma 1.5, data range 1 and sample
  /// covariances (times 121 / 120); only whole windows count, 5 px off each border.
  skimage,
  /// Plain weighted moments, zeros beyond the borders, every pixel counts: the loss of 3D Gaussian
  /// splatting.
  conv
};

/// Mean structural similarity of images whose values span 1:
///   (2 mx my + C1)(2 cxy + C2) / ((mx^2 + my^2 + C1)(vx + vy + C2)),  C1 = 0.01^2, C2 = 0.03^2
/// with means m, variances v and covariance c of a channel in the window around a pixel, averaged
/// over channels, images and the pixels that count.
/// Source: Wang et al. 2004, eq. 13.
/// x          [C H W] or [B C H W]
/// reference  x's shape; no gradient
/// kind       convention; SsimKind::skimage wants H and W of at least 11
/// mask       [H W], or [B H W] for images with their own; pixels of 0 do not count and read as 0
///            in both images, whatever they hold, where windows of others reach them. Empty for
///            none
/// returns    a scalar; 1 where no pixel counts
/// throws     ShapeError
/// memory     backward keeps three maps of x's size
template <class T>
BasicVar<T> ssim(const BasicVar<T>& x, const BasicTensor<T>& reference, SsimKind kind,
                 const BasicTensor<T>& mask = {});

/// What `ssim` says of the same images in double, bit by bit, without copies of them: rows become double
/// where they are compared.
/// x, reference, kind, mask  as there
/// returns    1 where no pixel counts
/// throws     ShapeError
double ssim_score(const Tensor& x, const Tensor& reference, SsimKind kind, const Tensor& mask = {});

}  // namespace satsurf

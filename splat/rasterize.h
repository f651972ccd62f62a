// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/quadratic.h"
#include "satsurf/core/var.h"

namespace satsurf::splat {

/// Flat Gaussian discs as a struct of tensors, in one local metric frame: x east, y north, z up, m.
template <class T>
struct BasicSurfels {
  BasicVar<T> means;  ///< [P 3] m
  /// [P 4] w x y z, any length but zero; the columns of R are the tangents t_u, t_v and the normal.
  BasicVar<T> quats;
  BasicVar<T> scales;   ///< [P 2] standard deviations along t_u and t_v, m
  BasicVar<T> opacity;  ///< [P] in (0, 1)
  BasicVar<T> colours;  ///< [P 3] linear in [0, 1]
  BasicVar<T> aux;      ///< [P K] any further channels, or empty
};
using Surfels = BasicSurfels<float>;

/// A camera as the splatter sees it: where each centre falls, and the local affine map there.
template <class T>
struct BasicProjection {
  BasicTensor<T> pixels;     ///< [P 2] x, y; integers are pixel centres
  BasicTensor<T> jacobians;  ///< [P 2 3] d(pixel)/d(world), px per m
};

/// Evaluates a camera at every centre, in double inside.
/// means             [P 3] m
/// pixel_from_local  local x, y, z in m -> pixel
/// returns           pixels and jacobians, without gradients
/// throws            ShapeError
template <class T>
BasicProjection<T> project(const BasicTensor<T>& means, const Quadratic& pixel_from_local);

/// What image to render.
struct RasterOptions {
  Index height = 0, width = 0;       ///< of the image, px
  double background[3] = {0, 0, 0};  ///< colour behind everything
  /// For gradient checks only: no alpha threshold, no early stop, no clamp, no bounding box.
  bool smooth_cutoffs = false;
};

/// Rendered maps. All but `median_height` carry gradients.
template <class T>
struct BasicRender {
  BasicVar<T> colour;  ///< [3 H W]
  BasicVar<T> height;  ///< [H W] expected height, m: sum(w h) / max(alpha, 1e-6)
  BasicVar<T> alpha;   ///< [H W] accumulated opacity
  BasicVar<T> normal;  ///< [3 H W] sum(w n), n towards the camera
  BasicVar<T> aux;     ///< [K H W] sum(w aux), or empty
  /// [H W] m, height of the surfel at which transmittance crosses 0.5; NaN where it never does.
  BasicTensor<T> median_height;
};
using Render = BasicRender<float>;

/// Differentiable splatting of surfels through per-surfel local affine cameras.
/// Pixel x sees surfel i at xi = J^-1 (x - pixel_i), J = jacobian [s_u t_u, s_v t_v], with
///   rho = min(|xi|^2, 2 |x - pixel_i|^2),  alpha = min(0.99, opacity exp(-rho / 2)),
/// and blends front to back, that is by descending height of the centres (ties in list order):
///   w = alpha T,  T <- T (1 - alpha),  stopping before T < 1e-4.
/// Alphas below 1/255 are skipped, and a surfel is looked for exactly where it may reach that, so
/// the search cuts nothing off. Its height in the pixel follows the disc's plane where |xi|^2 is
/// the smaller of the two, else it is the centre's.
/// Surfels with a number that is not finite, with opacity up to 1/255 or with |det J| < 1e-8 px^2
/// leave no trace and get zero gradients. Gradients reach all of `surfels`; those of the means
/// follow the pixel positions through the jacobians, which are themselves taken as constant.
/// Source: Huang et al. 2024 (2DGS); the ray-surfel intersection is linear here because the camera
/// is affine, and a pixel-wide filter keeps the height of the centre (ours).
/// surfels     [P ...]
/// projection  of the same means
/// options     the image
/// returns     maps of options.height x options.width; the same bits for any number of threads
/// throws      ShapeError
/// memory      backward keeps 16 + K numbers per surfel and tile it touches
/// cost        O(P log P + surfels x pixels they cover)
template <class T>
BasicRender<T> rasterize(const BasicSurfels<T>& surfels, const BasicProjection<T>& projection,
                         const RasterOptions& options);

}  // namespace satsurf::splat

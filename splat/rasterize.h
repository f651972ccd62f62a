// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/quadratic.h"
#include "satsurf/core/var.h"

namespace satsurf::splat {

/// Flat Gaussian discs as a struct of tensors, in one local metric frame (x east, y north, z up, m).
template <class T>
struct BasicSurfels {
  BasicVar<T> means;    ///< [P 3] m
  BasicVar<T> quats;    ///< [P 4] w x y z, any length but zero; columns of R are the tangents t_u, t_v and normal
  BasicVar<T> scales;   ///< [P 2] standard deviations along t_u and t_v, m
  BasicVar<T> opacity;  ///< [P] in (0, 1)
  BasicVar<T> colours;  ///< [P 3] linear in [0, 1]
  BasicVar<T> aux;      ///< [P K] any further channels, or empty
};
using Surfels = BasicSurfels<float>;

/// What a camera looks like to the splatter: where each centre falls, and the local affine map there.
template <class T>
struct BasicProjection {
  BasicTensor<T> pixels;     ///< [P 2] x, y; integers are pixel centres
  BasicTensor<T> jacobians;  ///< [P 2 3] d(pixel)/d(world), px per m
};

/// Evaluates a world-to-pixel quadratic (local x, y, z in m -> pixel) at every centre, in double inside.
/// means [P 3]
template <class T>
BasicProjection<T> project(const BasicTensor<T>& means, const Quadratic& pixel_from_local);

struct RasterOptions {
  Index height = 0, width = 0;                 ///< of the image, px
  double background[3] = {0, 0, 0};            ///< colour behind everything
  bool smooth_cutoffs = false;  ///< for gradient checks only: no alpha threshold, no early stop, no clamp, no bounding box
};

/// Rendered maps. All but `median_height` carry gradients.
template <class T>
struct BasicRender {
  BasicVar<T> colour;          ///< [3 H W]
  BasicVar<T> height;          ///< [H W] expected height, m: sum(w h) / max(alpha, 1e-6)
  BasicVar<T> alpha;           ///< [H W] accumulated opacity
  BasicVar<T> normal;          ///< [3 H W] sum(w n), n towards the camera
  BasicVar<T> aux;             ///< [K H W] sum(w aux), or empty
  BasicTensor<T> median_height;  ///< [H W] m, height of the surfel at which transmittance crosses 0.5; NaN where it never does
};
using Render = BasicRender<float>;

/// Differentiable splatting of surfels through per-surfel local affine cameras.
/// Source:  Huang et al. 2024 (2DGS), with the ray-surfel intersection made linear by the affine camera (ours).
/// throws ShapeError
template <class T>
BasicRender<T> rasterize(const BasicSurfels<T>& surfels, const BasicProjection<T>& projection,
                         const RasterOptions& options);

}  // namespace satsurf::splat

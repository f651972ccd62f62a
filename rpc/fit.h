// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/quadratic.h"
#include "satsurf/rpc/frame.h"
#include "satsurf/rpc/model.h"

namespace satsurf::rpc {

/// A rectangle of pixels: x in [x0 - 0.5, x0 + width - 0.5].
struct Window {
  double x0 = 0, y0 = 0, width = 0, height = 0;
};

/// Pixel transfer (x, y, z) in `reference` -> pixel in `source`. Least squares in double on an
/// 11 x 11 x 7 Newton grid over the window and the height range.
/// reference, source  cameras of the two images
/// frame              of z
/// window             pixels of `reference`
/// z_range            local m
/// returns            the map, with the residuals of the fit
/// throws             Error
Quadratic fit_transfer(const Rpc& reference, const Rpc& source, const LocalFrame& frame,
                       const Window& window, const HeightRange& z_range);
/// Localisation (x, y, z) -> local (x, y) in m, fitted as in `fit_transfer`.
/// rpc      camera of the image
/// frame    of x, y and z
/// window   pixels of the image
/// z_range  local m
/// returns  the map, with the residuals of the fit
/// throws   Error
Quadratic fit_localisation(const Rpc& rpc, const LocalFrame& frame, const Window& window,
                           const HeightRange& z_range);
/// Projection: local (x, y, z) in m -> pixel, fitted over the ground that a window sees.
/// rpc      camera of the image
/// frame    of x, y and z
/// window   pixels of the image
/// z_range  local m
/// returns  the map, with the residuals of the fit
/// throws   Error
Quadratic fit_projection(const Rpc& rpc, const LocalFrame& frame, const Window& window,
                         const HeightRange& z_range);

/// The local orientation and size of a pixel.
struct ViewGeometry {
  std::array<double, 4> quat;  ///< w x y z, camera-to-world rotation of the local affine camera
  double footprint;            ///< across-ray ground size of a pixel, m
  /// Ground displacement along the ray per metre of height, z = 1.
  std::array<double, 3> direction;
};
/// From the camera's derivatives at one point.
/// jacobian  d(pixel)/d(world), 2 x 3, px per m
/// throws    Error for a mirrored image (the third axis would point up)
ViewGeometry view_geometry(const PixelJacobian& jacobian);

}  // namespace satsurf::rpc

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

/// Heights above the ellipsoid, m.
struct HeightRange {
  double low = 0, high = 0;
};

/// Pixel transfer (x, y, z) in `reference` -> pixel in `source`; z = h - frame.h0. Least squares in
/// double on an 11 x 11 x 7 Newton grid over the window and the height range; residuals are stored
/// in the result.
Quadratic fit_transfer(const Rpc& reference, const Rpc& source, const LocalFrame& frame,
                       const Window& window, const HeightRange& range);
/// Localisation (x, y, z) -> local (x, y) in m.
Quadratic fit_localisation(const Rpc& rpc, const LocalFrame& frame, const Window& window,
                           const HeightRange& range);
/// Projection: local (x, y, z) in m -> pixel; fitted over the ground that `window` sees in `range`.
Quadratic fit_projection(const Rpc& rpc, const LocalFrame& frame, const Window& window,
                         const HeightRange& range);

/// The local orientation and size of a pixel, from the 2 x 3 Jacobian d(pixel)/d(world) in px per
/// m.
struct ViewGeometry {
  std::array<double, 4> quat;  ///< w x y z, camera-to-world rotation of the local affine camera
  double footprint;            ///< across-ray ground size of a pixel, m
  std::array<double, 3>
      direction;  ///< ground displacement along the ray per metre of height, z = 1
};
/// throws Error for a mirrored image (the third axis would point up)
ViewGeometry view_geometry(const std::array<std::array<double, 3>, 2>& jacobian);

}  // namespace satsurf::rpc

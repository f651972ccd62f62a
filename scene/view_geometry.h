// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/rpc/frame.h"
#include "satsurf/scene/polygon.h"

#include <array>
#include <vector>

namespace satsurf::scene {

/// The four corners of an image on the ground.
/// width, height  of the image, px
/// zone           of the result
/// h              m above the ellipsoid
/// throws         Error
Polygon footprint(const rpc::Rpc& rpc, Index width, Index height, const rpc::UtmZone& zone,
                  double h);

/// What two images both see at height h above the ellipsoid; empty if they do not meet, which images
/// degrees apart never do.
struct CommonGround {
  rpc::UtmZone zone;  ///< of the polygon
  Polygon both;
  double share = 0;  ///< of the smaller image
};
/// a, b, with the width and height of their images in px
/// throws  Error
CommonGround common_ground(const rpc::Rpc& a, Index width_a, Index height_a, const rpc::Rpc& b,
                           Index width_b, Index height_b, double h);

/// How a camera looks at its image's centre at height h.
struct ViewAngles {
  double gsd = 0;            ///< ground size of a pixel across the ray, m
  double off_nadir_deg = 0;  ///< between the ray and the vertical at the ground
  double azimuth_deg = 0;    ///< from the ground towards the satellite, clockwise from north
};
/// Those of an image of width x height px at h m above the ellipsoid.
/// throws  Error
ViewAngles view_angles(const rpc::Rpc& rpc, Index width, Index height, double h);

/// Derivatives of the cameras of views, surveyed ones or others, at a place in local metres.
template <class Views>
std::vector<rpc::PixelJacobian> cameras_at(const Views& views, const rpc::LocalFrame& frame,
                                           const std::array<double, 3>& place) {
  std::vector<rpc::PixelJacobian> cameras;
  for (const auto& view : views) cameras.push_back(rpc::pixel_jacobian(view.rpc, frame, place));
  return cameras;
}

/// Pixels by which a ground point moves in `b` against `a` per metre of height, at (lon, lat, h).
double parallax(const rpc::Rpc& a, const rpc::Rpc& b, const rpc::Geodetic& p);

}  // namespace satsurf::scene

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/quadratic.h"
#include "satsurf/splat/rasterize.h"

namespace satsurf::splat {

/// Renders surfels into a view at a whole fraction of its resolution.
/// surfels           in the local frame
/// pixel_from_local  the view's projection, in image pixels
/// height, width     of the view, image pixels
/// stride            image pixels per rendered pixel: 4, 2 or 1
/// returns           maps of height / stride x width / stride
template <class T>
BasicRender<T> render_view(const BasicSurfels<T>& surfels, const Quadratic& pixel_from_local,
                           Index height, Index width, Index stride);

/// The camera that looks straight down on a grid.
/// x0, y0   upper-left corner, local m
/// step     side of a cell, m
/// returns  local x, y, z in m -> cell
Quadratic nadir_camera(double x0, double y0, double step);

/// Heights of a rendered surface [H W]: the median, which keeps edges sharp, where at least half
/// the light is stopped; the mean where surfels are sparser than that, as on ground seen at a
/// grazing angle; NaN where next to nothing (less than 0.05) is.
Tensor surface_heights(const Render& render);

/// Colours of a rendered surface [3 H W]: nothing shines through one, so where at least half the
/// light is stopped they are taken as if all of it were; where less is, they fade to black.
Tensor surface_colours(const Render& render);

}  // namespace satsurf::splat

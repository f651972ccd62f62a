// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/rpc/height_range.h"
#include "satsurf/scene/raycast.h"
#include "satsurf/splat/rasterize.h"

#include <string>

namespace satsurf::app {

/// The cells of a view from straight above, in the local frame.
struct GridFromAbove {
  scene::HeightField field;  ///< without heights
  Index height = 0, width = 0;
};

/// The cells that surfels lie in, as whole multiples of the step from the frame's origin.
/// surfels  with one at least
/// step     side of a cell, m
GridFromAbove grid_from_above(const splat::Surfels& surfels, double step);

/// Lowest and highest middle of surfels, m.
/// where   begins the error text
/// throws  IoError if there are no surfels
rpc::HeightRange heights_of(const splat::Surfels& surfels, const std::string& where);

/// Says no to a picture that is too large for the memory.
/// where            begins the error text
/// bytes_per_pixel  of all that is made of it
/// hint             ends it
/// throws           Error
void check_rendered_size(const std::string& where, Index width, Index height,
                         double bytes_per_pixel, const std::string& hint);
/// Of a rendered view and the picture written of it.
inline constexpr double kRenderBytes = 90;

/// Surfels as seen from straight above, one pixel per cell.
/// bytes_per_cell  of all that is made of it
/// throws          Error for more cells than fit into the memory
splat::Render render_from_above(const splat::Surfels& surfels, const GridFromAbove& grid,
                                double bytes_per_cell = kRenderBytes);

}  // namespace satsurf::app

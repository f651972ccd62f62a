// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/mesh/tsdf.h"
#include "satsurf/scene/scene.h"
#include "satsurf/splat/rasterize.h"

namespace satsurf::reconstruct {

/// Camera of a whole image over a range of heights.
/// frame          of the result
/// width, height  of the image, px
/// z_low, z_high  local m, widened by one for the sake of flat surfaces
/// returns        local x, y, z in m -> px
Quadratic image_camera(const rpc::Rpc& rpc, const rpc::LocalFrame& frame, Index width, Index height,
                       double z_low, double z_high);
/// Its inverse at a height.
/// returns  x px, y px, z m -> local x, y in m
Quadratic image_localisation(const rpc::Rpc& rpc, const rpc::LocalFrame& frame, Index width,
                             Index height, double z_low, double z_high);

/// A surface as the camera of an image sees it.
struct SurfaceView {
  Tensor colour;             ///< [3 H W], rendered
  mesh::HeightView heights;  ///< for a mesh; its colours are the image's
};
/// Renders surfels into a view of the scene they are of.
SurfaceView rendered_view(const splat::Surfels& surfels, const scene::View& view,
                          const scene::Scene& scene);
/// The same of the true surface, without colours.
mesh::HeightView true_view(const scene::HeightField& truth, const scene::View& view,
                           const scene::Scene& scene);
/// Leaves of a view the heights above the cells of a grid that count, those with `mask` > 0.
/// field  the grid, [H W] as the mask
void keep_inside(mesh::HeightView& view, const scene::HeightField& field, const Tensor& mask);

}  // namespace satsurf::reconstruct

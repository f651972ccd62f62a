// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/mesh/tsdf.h"
#include "satsurf/nn/input.h"
#include "satsurf/scene/raycast.h"
#include "satsurf/splat/rasterize.h"

namespace satsurf::reconstruct {

/// Surfels as the camera of an image sees them.
struct RenderedView {
  Tensor colour;              ///< [3 H W], rendered
  mesh::HeightImage heights;  ///< for a mesh; its colours are the image's
};
/// Renders surfels into an image.
/// image  whole, in the frame of the surfels
RenderedView rendered_view(const splat::Surfels& surfels, const nn::PosedImage& image);
/// A surface of cells with colours as the camera of an image sees it: what large surfaces are shown
/// by, whose surfels are too many.
/// surface  its cells are columns with vertical walls
/// colours  [3 H W] of its cells, in [0, 1]
/// returns  [3 h w] in the size of the image; black where it shows nothing of the surface, or of its
///          colours
/// throws   ShapeError
Tensor draped_view(const scene::HeightField& surface, const Tensor& colours,
                   const nn::PosedImage& image);
/// What the camera of an image sees of the true surface, without colours.
mesh::HeightImage true_view(const scene::HeightField& truth, const nn::PosedImage& image);
/// Leaves of a view the heights above the cells of a grid that count, those with `mask` > 0.
/// field  the grid, [H W] as the mask
void keep_inside(mesh::HeightImage& view, const scene::HeightField& field, const Tensor& mask);

}  // namespace satsurf::reconstruct

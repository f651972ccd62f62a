// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/input.h"
#include "satsurf/reconstruct/outvoted.h"
#include "satsurf/scene/raycast.h"

#include <functional>
#include <vector>

namespace satsurf::reconstruct {

/// Which images see the cells of a surface.
struct Visibility {
  Tensor views;  ///< [H W] how many see the cell; NaN where it has no height
  /// [H W] of those the one that looks down most steeply and that the others do not outvote, else of
  /// all of them; -1 for none.
  std::vector<Index> best;
};
/// Casts a ray from every cell's centre to every camera. Cells are columns with vertical walls, and
/// one sees what lies on a valid pixel with nothing of the surface before it; cells without a height
/// hide nothing.
/// surface  in the local frame
/// images     whole, in the same frame
/// exposures  of the images, by which clouds are told, see `Outvoted`; none for nothing outvoted
/// cost       at most a ray per view and cell, and that of `Outvoted`
Visibility find_visibility(const scene::HeightField& surface,
                           const std::vector<nn::PosedImage>& images,
                           const Exposures& exposures = {});

/// The surface from straight above in the colours of the image that sees each cell best, so that no
/// wall or roof is drawn on the ground that it hides. Seams between images of different light are
/// not smoothed.
/// surface, images  as for `find_visibility`
/// pixels           of one of the images by its number, [C h w], asked for once and only where it is
///                  the best of a cell; all of the same number of channels
/// returns          [C H W], between pixels linear; NaN where no image sees the cell; empty if none
///                  sees any
/// throws           ShapeError for pixels of another size than the image
Tensor orthophoto(const scene::HeightField& surface, const std::vector<nn::PosedImage>& images,
                  const Visibility& visibility, const std::function<Tensor(Index)>& pixels);

}  // namespace satsurf::reconstruct

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/surface_net.h"
#include "satsurf/reconstruct/fusion.h"

#include <vector>

namespace satsurf::reconstruct {

/// What the surface network is given, of the surfels of all views and of their images.
/// Candidates: the modes of each cell's surfels as in `fuse_surfels`, weighed by the same evidence,
/// and their tails; the median of the modes in blocks of 2.5 m, the unknown ones filled from their
/// neighbours four times, and in between bilinear; and the lowest tenth of what the blocks within
/// 11 m have for their lowest fifth.
/// Disagreement: with each image's brightness as `nn::locally_normalised` makes it, read where the
/// image shows the cell's middle at the candidate's height, the mean difference of all pairs of
/// images that show it, halved, and that of the pair that agrees best; 1 where there is no pair. Where
/// more than 16 show it the first 16 count. Those see it in which the modes of no other cells, in holes `around`, stand
/// more than one interval above the line of sight (`sight_horizon`).
/// means, confidence, evidence, grid  as `fuse_surfels`
/// images  whole, with their cameras
/// throws  ShapeError
nn::SurfaceInput surface_input(const Tensor& means, const Tensor& confidence,
                               const SurfelEvidence& evidence, const FusionGrid& grid,
                               const std::vector<nn::PosedImage>& images);

}  // namespace satsurf::reconstruct

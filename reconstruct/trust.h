// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/input.h"
#include "satsurf/reconstruct/plan.h"

#include <optional>
#include <vector>

namespace satsurf::reconstruct {

/// Which surfels of a window are kept: those of valid pixels whose point falls on a valid pixel of
/// another view too. Where images end some heights can be compared and others cannot, and a pixel
/// whose true height is one of the latter gets a wrong one. So a surfel needs another view that
/// gives its point the same height within 2.5 m, or one that sees its pixel's point at both ends of
/// the height range, and with that at every height.
/// input    the window of N views, H x W px
/// means    [P 3] centres of the surfels, those of the pixels first, P >= N H W; local m
/// heights  [N H W] height of every pixel, local m
/// tile     only surfels centred in it, if given
/// returns  indices of surfels, ascending
std::vector<Index> trusted_surfels(const nn::NetworkInput& input, const Tensor& means,
                                   const Tensor& heights, const std::optional<Ground>& tile);

}  // namespace satsurf::reconstruct

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/nn/input.h"

#include <vector>

namespace satsurf::reconstruct {

// The surface `plain`: what each surfel is worth by what the other views say of it, then, cell by
// cell, the height most of that weight stands for.

/// What fusion knows of surfels beside their places.
struct SurfelEvidence {
  Tensor weight;  ///< [P] what each counts for
  Tensor rays;    ///< [P 2] m east and north that the ray to its camera moves per metre of height
  Index compared = 0;  ///< times that a surfel fell on a pixel of another view
  Index agreed = 0;    ///< how often that one's height agreed with it
};

/// Weighs the surfels of a window's pixels. Another view into which a surfel falls found, in the
/// pixel where it does, a height that differs from the surfel's by d. With t, the metres of height
/// that move a point by one pixel in that view (0.5 to 2.5), e = |d| / t, and c that pixel's
/// confidence, it
///   agrees       e <= 1         A grows by c (1 - e^2 / 2)
///   hides it     d > t          the view says nothing: it sees something in front
///   contradicts  d < -t         B grows by c min(1, e - 1): it sees through the surfel
/// and the surfel's weight is its own confidence times (1 + A) / (1 + A + 2 B). A view that does
/// not see it says nothing.
/// input       the window of N views, H x W px
/// heights     [N H W] local m
/// confidence  [N H W] in [0, 1]
/// keep        the pixels whose surfels are wanted, by their number in N H W
/// returns     evidence of these, in their order
/// throws      ShapeError
SurfelEvidence surfel_evidence(const nn::NetworkInput& input, const Tensor& heights,
                               const Tensor& confidence, const std::vector<Index>& keep);

/// Height that moves a point by one pixel between two views of a window on average, m.
double parallax_interval(const nn::NetworkInput& input);

/// Where and how finely surfels are fused.
struct FusionGrid {
  double east = 0, north = 0;   ///< upper-left corner, local m
  double step = 0;              ///< side of a cell, m
  Index height = 0, width = 0;  ///< cells
  double footprint = 0;         ///< ground size of a pixel, m
  double interval = 0;          ///< see `parallax_interval`, m
};

/// A surface, and the surfels it is made of.
struct FusedSurface {
  Tensor heights;           ///< [H W] local m, NaN where no surfel reaches
  Tensor confidence;        ///< [H W] in [0, 1], NaN alike
  std::vector<Index> kept;  ///< surfels, ascending, that are not far from it
};

/// Fuses surfels into one height per cell.
/// A surfel reaches the cells that a square of 1.5 pixels around it overlaps, each with its weight
/// times the overlap. A cell's height is the densest mode of what reaches it: with the triangular
/// kernel of half width b, the interval limited to 0.3 to 2 m, the weighted density is largest at
/// one of its surfels, the lowest of them where several are equal, and the mean of all within b of
/// that one is the height. Its confidence is their mean confidence, weighed alike, times their share
/// of the cell's weight.
/// Then surfels go that float above the surface, or hide below it: those farther than b above or
/// below all cells next to theirs, and those whose ray to the camera, within 32 cells, passes more
/// than b below a cell and all its neighbours. The cells they reached are fused again.
/// means       [P 3] local m
/// confidence  [P] in [0, 1]
/// evidence    of the same surfels
/// returns     the surface; the same bits for any number of threads
/// throws      ShapeError
FusedSurface fuse_surfels(const Tensor& means, const Tensor& confidence,
                          const SurfelEvidence& evidence, const FusionGrid& grid);

}  // namespace satsurf::reconstruct

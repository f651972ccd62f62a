// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/tensor.h"

namespace satsurf::evaluate {

/// Fills holes by inverse-distance interpolation: an unknown cell becomes the mean of the nearest
/// known cell in each of the four quadrants around it, weighed by 1 / distance^2. A quadrant holds
/// one of its two axes, so that each cell lies in one. Where two cells of a quadrant are equally
/// near, the one in the nearer column is taken.
/// z        [H W], NaN where unknown
/// returns  [H W] without NaN; a copy of z if nothing is known
Tensor filled(const Tensor& z);

}  // namespace satsurf::evaluate

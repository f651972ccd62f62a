// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/tensor.h"

namespace satsurf::reconstruct {

/// Evens out heights in doubt where images look alike at all heights: roofs of halls and sealed ground,
/// of which nothing but the rim tells how high they are.
/// In doubt are cells by g, from 0 at an expected error of 1 m to 1 at 2 m. Untextured are squares of
/// 10 m in which the standard deviation of no colour is above 3 %, which a sensor's noise is; where a
/// fifth of the cells of one are in doubt, g counts within 5 m of its middle, elsewhere it is 0. The
/// heights z become those of least
///   sum over cells ((z - found) / sigma)^2 + 30 m^-2 sum over neighbours g c d (z - z')^2,
/// with the larger g of the two, c = exp(-(largest difference of a colour / 4 %)^2) and
/// d = (1 + (difference of heights / 3 m)^2)^-2, which keep edges; d follows z three times. So what is
/// sure stays, and what is not goes along with it as far as the colour does. Expected errors are evened
/// out by the same weights, as if all errors went one way: they are no smaller than those of the rim.
/// heights  [H W] local m, NaN where there is none
/// sigma    [H W] their expected errors, m, NaN alike
/// colours  [C H W] logarithms of brightness above black
/// step     side of a cell, m
/// returns  cells in doubt that were evened out
/// throws   ShapeError
Index even_untextured(Tensor& heights, Tensor& sigma, const Tensor& colours, double step);

}  // namespace satsurf::reconstruct

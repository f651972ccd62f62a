// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/tensor.h"

namespace satsurf::reconstruct {

/// Makes level what no image tells the heights of within a level shore: water, where every image shows
/// another glitter, and at times snow or a cloud on a plain.
/// In doubt are cells whose expected error is above 3 m and whose confidence is below 0.3. Where they are
/// more than half of all within 3.5 m, in one piece of 2000 m² or more, the piece grows by up to 10 m into
/// what is not sure to a metre. Its shore are the sure cells among those within three cells around, which half of
/// these have to be, and in each square of 20 m its height is what a tenth of them lies below: houses may stand on it.
/// Where at least half of the squares, five or more, lie within a metre of their median, the piece gets that
/// height, and 1.5 m as its expected error, in both; its confidence stays low. Boats and bridges, being sure, stay. On a
/// slope this is not so; of a wood even the low tenth is found more than a metre above its rim; and around a
/// courtyard among roofs more than a tenth of the sure cells within 50 m lie 3 m lower: all that stays as it was.
/// heights     [H W] local m, NaN where there is none
/// sigma       [H W] their expected errors, m, NaN alike, as they are delivered
/// doubt       [H W] the same as `nn::RefinedSurface` has it, by which it is judged here
/// confidence  [H W] in [0, 1], NaN alike
/// step        side of a cell, m
/// returns     cells that got a height of a shore
Index level_water(Tensor& heights, Tensor& sigma, Tensor& doubt, const Tensor& confidence,
                  double step);

}  // namespace satsurf::reconstruct

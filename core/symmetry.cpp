// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/symmetry.h"

namespace satsurf {

Tensor turned(const Tensor& map, Index symmetry) {
  const Index axes = map.rank(), S = axes < 2 ? 0 : map.dim(axes - 1);
  if (axes < 2 || axes > 3 || map.dim(axes - 2) != S)
    throw ShapeError("turned: map has shape " + map.shape().str() + ", expected [S S] or [C S S]");
  auto out = Tensor::uninitialised(map.shape());
  if (out.count() == 0) return out;
  // Where the map's cells for a row, and for the cells of that row, begin and how far apart they are.
  const bool swapped = (symmetry & 4) != 0;
  const Index row_step = (swapped ? 1 : S) * ((symmetry & 2) != 0 ? -1 : 1),
              column_step = (swapped ? S : 1) * ((symmetry & 1) != 0 ? -1 : 1),
              origin = (row_step < 0 ? -row_step : 0) * (S - 1) +
                       (column_step < 0 ? -column_step : 0) * (S - 1);
  float* to = out.data();
  for (const float* plane = map.data(); plane < map.data() + map.count(); plane += S * S)
    for (Index row = 0; row < S; ++row) {
      const float* from = plane + origin + row * row_step;
      for (Index column = 0; column < S; ++column) *to++ = from[column * column_step];
    }
  return out;
}

}  // namespace satsurf

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/from_above.h"

#include "satsurf/core/error.h"
#include "satsurf/core/memory.h"
#include "satsurf/splat/view.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace satsurf::app {
namespace {

/// Smallest and largest element of one column of [P 3].
std::pair<double, double> column_range(const Tensor& means, Index column) {
  double low = INFINITY, high = -INFINITY;
  for (Index i = column; i < means.count(); i += 3)
    if (std::isfinite(means[i]))
      low = std::min(low, static_cast<double>(means[i])),
      high = std::max(high, static_cast<double>(means[i]));
  return {low, high};
}

}  // namespace

GridFromAbove grid_from_above(const splat::Surfels& surfels, double step) {
  const auto [x_low, x_high] = column_range(surfels.means.value(), 0);
  const auto [y_low, y_high] = column_range(surfels.means.value(), 1);
  return {{{}, std::floor(x_low / step) * step, std::ceil(y_high / step) * step, step},
          static_cast<Index>(std::ceil((y_high - y_low) / step)) + 1,
          static_cast<Index>(std::ceil((x_high - x_low) / step)) + 1};
}

rpc::HeightRange heights_of(const splat::Surfels& surfels, const std::string& where) {
  const auto [low, high] = column_range(surfels.means.value(), 2);
  if (!(low <= high)) throw IoError(where + ": no surfels, expected a surface");
  return {low, high};
}

void check_rendered_size(const std::string& where, Index width, Index height,
                         double bytes_per_pixel, const std::string& hint) {
  check_memory(where + std::to_string(width) + " x " + std::to_string(height) + " pixels need",
               bytes_per_pixel * static_cast<double>(width) * static_cast<double>(height), hint);
}

splat::Render render_from_above(const splat::Surfels& surfels, const GridFromAbove& grid,
                                double bytes_per_cell) {
  check_rendered_size("from above: ", grid.width, grid.height, bytes_per_cell,
                      "give a larger --resolution");
  return splat::render_view(surfels,
                            splat::nadir_camera(grid.field.x0, grid.field.y0, grid.field.step),
                            grid.height, grid.width, 1);
}

}  // namespace satsurf::app

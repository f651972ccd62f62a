// SPDX-License-Identifier: Apache-2.0
#include "satsurf/reconstruct/cast.h"

#include "satsurf/core/dims.h"
#include "satsurf/core/parallel.h"
#include "satsurf/scene/ray_walk.h"
#include "satsurf/splat/select.h"

#include <cmath>
#include <utility>
#include <vector>

namespace satsurf::reconstruct {

splat::Surfels cast_on(const splat::Surfels& surfels, const Tensor& rays,
                       const scene::HeightField& surface) {
  Dims dim("cast_on");
  dim.match("means", surfels.means.value(), "P 3").match("rays", rays, "P 2");
  const Index P = dim["P"];
  const scene::ColumnField columns(surface);
  if (columns.empty()) return splat::selected(surfels, {});
  Tensor means = surfels.means.value().clone();
  const double high = columns.high(), low = columns.low();
  for_range(P, 1 << 12, [&](Index begin, Index end) {
    for (Index k = begin; k < end; ++k) {
      float* p = means.data() + 3 * k;
      const double x = static_cast<double>(p[0]), y = static_cast<double>(p[1]),
                   z = static_cast<double>(p[2]), east = static_cast<double>(rays[2 * k]),
                   north = static_cast<double>(rays[2 * k + 1]);
      const auto hit = columns.walk(x + (high - z) * east, y + (high - z) * north,
                                    x + (low - z) * east, y + (low - z) * north);
      const double up = static_cast<double>(hit.z) - z;
      p[0] = static_cast<float>(x + up * east);
      p[1] = static_cast<float>(y + up * north);
      p[2] = hit.z;
    }
  });
  std::vector<Index> met;
  for (Index k = 0; k < P; ++k)
    if (std::isfinite(means[3 * k + 2])) met.push_back(k);
  splat::Surfels moved = surfels;
  moved.means = Var(std::move(means));
  return splat::selected(moved, met);
}

}  // namespace satsurf::reconstruct

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/simulate/texture.h"

#include "satsurf/core/box_filters.h"
#include "satsurf/core/parallel.h"

#include <algorithm>
#include <cmath>

namespace satsurf::scene::simulate {
namespace {

void shape(std::vector<SurfaceCell>& cells, const Tensor& z, float step, const Tensor& near,
           const Tensor& far, Index i, Index j) {
  const Index N = z.dim(0), k = i * N + j;
  SurfaceCell& cell = cells[static_cast<std::size_t>(k)];
  const float steepest = 3.0f * step;
  const auto slope = [&](Index before, Index after) {
    float sum = 0, count = 0;
    for (const Index other : {before, after}) {
      if (other < 0) continue;
      const SurfaceCell& o = cells[static_cast<std::size_t>(other)];
      const float dz = z[other] - z[k];
      const bool same = o.part == cell.part &&
                        (o.material == Material::tree) == (cell.material == Material::tree);
      if (!same || std::abs(dz) > steepest) continue;
      sum += other == after ? dz : -dz;
      count += 1;
    }
    const float g = count > 0 ? sum / (count * step) : 0.0f;
    return static_cast<std::int16_t>(std::lround(4096.0f * std::clamp(g, -4.0f, 4.0f)));
  };
  cell.slope_x = slope(j > 0 ? k - 1 : -1, j + 1 < N ? k + 1 : -1);
  cell.slope_y = slope(i + 1 < N ? k + N : -1, i > 0 ? k - N : -1);
  const float hidden =
      0.09f * std::max(0.0f, near[k] - z[k]) + 0.05f * std::max(0.0f, far[k] - z[k]);
  cell.sky = static_cast<std::uint8_t>(255.0f / (1 + hidden));
}

}  // namespace

Texture texture_of(Material m) {
  switch (m) {
    case Material::asphalt:
      return {0.05f, 0.05f, 0.09f, 0.12f};
    case Material::concrete:
      return {0.05f, 0.07f, 0.10f, 0.08f};
    case Material::grass:
      return {0.12f, 0.16f, 0.20f, 0.18f};
    case Material::soil:
      return {0.09f, 0.13f, 0.16f, 0.16f};
    case Material::rock:
      return {0.14f, 0.28f, 0.22f, 0.20f};
    case Material::field:
      return {0.08f, 0.10f, 0.10f, 0.10f};
    case Material::tree:
      return {0.20f, 0.30f, 0.05f, 0.05f};
    case Material::roof:
      return {0.025f, 0.02f, 0.07f, 0.02f};
    case Material::water:
    case Material::car:
      return {0, 0, 0, 0};
  }
  return {};
}

void shape_cells(City& city) {
  const auto step = static_cast<float>(city.field.step);
  const Index N = city.field.z.dim(0);
  const Tensor near = box_mean(city.field.z, static_cast<Index>(std::lround(4.0f / step)));
  const Tensor far = box_mean(near, static_cast<Index>(std::lround(9.0f / step)));
  for_range(N, 32, [&](Index begin, Index end) {
    for (Index i = begin; i < end; ++i) {
      for (Index j = 0; j < N; ++j) {
        const auto k = static_cast<std::size_t>(i * N + j);
        shape(city.cells, city.field.z, step, near, far, i, j);
        // Under no tree the floor is what is seen anyway.
        if (!city.floor.empty() && city.cells[k].material == Material::tree)
          shape(city.floor, city.floor_z, step, near, far, i, j);
      }
    }
  });
}

}  // namespace satsurf::scene::simulate

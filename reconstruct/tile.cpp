// SPDX-License-Identifier: Apache-2.0
#include "satsurf/reconstruct/tile.h"

#include "satsurf/reconstruct/cell_count.h"
#include "satsurf/reconstruct/narrow.h"
#include "satsurf/reconstruct/ortho.h"
#include "satsurf/splat/select.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace satsurf::reconstruct {
namespace {

/// Whether two views show any of some points spread over a tile.
bool shown_by_two(const scene::Scene& scene, const Ground& ground) {
  constexpr int kTried = 48;  // a side
  for (int i = 0; i < kTried; ++i)
    for (int j = 0; j < kTried; ++j)
      if (views_showing(scene, {ground.x0 + (j + 0.5) / kTried * ground.width(),
                                ground.y0 + (i + 0.5) / kTried * ground.height(),
                                scene.z_range.middle()}) >= 2)
        return true;
  return false;
}

/// The part [.. h w] of [.. H W].
Tensor part_of(const Tensor& whole, Index y0, Index x0, Index h, Index w) {
  const bool planes = whole.rank() == 3;
  const Index C = planes ? whole.dim(0) : 1, H = whole.dim(planes ? 1 : 0),
              W = whole.dim(planes ? 2 : 1);
  auto out = Tensor::uninitialised(planes ? Shape{C, h, w} : Shape{h, w});
  for (Index c = 0; c < C; ++c)
    for (Index y = 0; y < h; ++y)
      std::copy_n(whole.data() + (c * H + y0 + y) * W + x0, w, out.data() + (c * h + y) * w);
  return out;
}

/// The surfels whose centres lie over a ground.
splat::Surfels over(const splat::Surfels& surfels, const Ground& ground) {
  const Tensor& means = surfels.means.value();
  std::vector<Index> keep;
  for (Index i = 0; i < means.dim(0); ++i)
    if (ground.contains(static_cast<double>(means[3 * i]), static_cast<double>(means[3 * i + 1])))
      keep.push_back(i);
  return keep.empty() ? splat::Surfels{} : splat::selected(surfels, keep);
}

}  // namespace

TileSurface reconstruct_tile(const nn::Model& model, const scene::WindowedScene& part,
                             const Tiling& tiling, const Tile& tile,
                             const ReconstructOptions& options) {
  TileSurface out;
  const Grid grid = tiling.grid_of(tile.all), core = tiling.grid_of(tile.core);
  if (part.scene.views.size() < 2 || !shown_by_two(part.scene, grid.ground())) return out;
  const Tensor unwanted = options.unwanted ? options.unwanted(core) : Tensor();
  if (!unwanted.empty() && std::ranges::all_of(unwanted.values(), [](float v) { return v > 0; }))
    return out;
  const NoGrad no_grad;
  scene::Scene scene = part.scene;
  scene.z_range = narrowed_range(
      model, scene,
      [&] {
        if (options.progress) options.progress("network", 0);
      },
      options.unwanted);
  ReconstructOptions how = options;
  how.grid = grid, how.narrow = false, how.mesh = {};
  how.window =
      scene::window_around(scene, grid.ground(), tiling.window, nn::size_multiple(model.config()));
  Reconstruction made = reconstruct(model, scene, how);

  out.empty = false;
  out.z_range = made.z_range, out.camera_fit_max_px = made.camera_fit_max_px;
  out.window = how.window;
  const Visibility seen = find_visibility(made.dsm, made.images);
  const Tensor ortho = orthophoto(made.dsm, made.images, seen, [&](Index i) {
    return part.values[static_cast<std::size_t>(i)];
  });
  const Index y0 = tile.core.y0 - tile.all.y0, x0 = tile.core.x0 - tile.all.x0, h = core.height,
              w = core.width;
  out.views = part_of(seen.views, y0, x0, h, w);
  if (!ortho.empty()) out.ortho = part_of(ortho, y0, x0, h, w);
  const CellCount cells =
      count_cells({part_of(made.dsm.z, y0, x0, h, w), core.east, core.north, core.step},
                  made.images, scene.z_range.middle(), unwanted);
  out.found = cells.found, out.expected = cells.expected;
  out.surfels = over(made.surfels, core.ground());
  out.heights = std::move(made.dsm.z);
  out.confidence = std::move(made.confidence);
  out.sigma = std::move(made.sigma);
  return out;
}

}  // namespace satsurf::reconstruct

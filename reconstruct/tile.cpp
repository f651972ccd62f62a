// SPDX-License-Identifier: Apache-2.0
#include "satsurf/reconstruct/tile.h"

#include "satsurf/reconstruct/cell_count.h"
#include "satsurf/reconstruct/laid_surfels.h"
#include "satsurf/reconstruct/narrow.h"
#include "satsurf/reconstruct/ortho.h"
#include "satsurf/splat/select.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace satsurf::reconstruct {
namespace {

/// Whether two views show any of some points spread over a tile.
bool any_shown_by_two(const scene::Scene& scene, const scene::Polygon& ground) {
  constexpr int kTried = 48;  // a side
  const Ground box = scene::bounds_of(ground);
  for (int i = 0; i < kTried; ++i)
    for (int j = 0; j < kTried; ++j) {
      const double x = box.x0 + (j + 0.5) / kTried * box.width(),
                   y = box.y0 + (i + 0.5) / kTried * box.height();
      if (scene::contains(ground, x, y) &&
          views_showing(scene, {x, y, scene.z_range.middle()}) >= 2)
        return true;
    }
  return false;
}

/// The part [h w] of [H W].
Tensor part_of(const Tensor& whole, Index y0, Index x0, Index h, Index w) {
  auto out = Tensor::uninitialised({h, w});
  for (Index y = 0; y < h; ++y)
    std::copy_n(whole.data() + (y0 + y) * whole.dim(1) + x0, w, out.data() + y * w);
  return out;
}

/// The surfels whose centres lie over what a tile answers for.
/// inside  of its core, [h w] 1 where there are some, or empty for everywhere
splat::Surfels over(const splat::Surfels& surfels, const Tiling& tiling, const Tile& tile,
                    const Tensor& inside) {
  const Grid core = tiling.grid_of(tile.core);
  const auto cell = [&](double distance, Index most) {
    return std::clamp<Index>(static_cast<Index>(std::floor(distance / core.step)), 0, most - 1);
  };
  const Tensor& means = surfels.means.value();
  std::vector<Index> keep;
  for (Index i = 0; i < means.dim(0); ++i) {
    const auto x = static_cast<double>(means[3 * i]), y = static_cast<double>(means[3 * i + 1]);
    if (!tiling.owns_place(tile, x, y)) continue;
    const Index at =
        cell(core.north - y, core.height) * core.width + cell(x - core.east, core.width);
    if (inside.empty() || inside[at] > 0) keep.push_back(i);
  }
  return keep.empty() ? splat::Surfels{} : splat::selected(surfels, keep);
}

/// Says of the cells of a tile's core which do not count, by 1: those that others answer for, those
/// on ground that is not wanted and those outside of what is asked for.
Tensor not_counted(const Tiling& tiling, const Tile& tile, const Tensor& unwanted,
                   const Tensor& inside) {
  const Index w = tile.core.width();
  Tensor out({tile.core.height(), w});
  for (Index i = 0; i < out.count(); ++i)
    if (!tiling.owns(tile, tile.core.x0 + i % w, tile.core.y0 + i / w) ||
        (!unwanted.empty() && unwanted[i] > 0) || (!inside.empty() && !(inside[i] > 0)))
      out[i] = 1;
  return out;
}

/// What `which` says of the cells of a tile's core; empty where it says nothing.
Tensor of_core(const Tiling& tiling, const Tile& tile,
               const std::function<Tensor(const Grid&)>& which) {
  return which ? which(tiling.grid_of(tile.core)) : Tensor();
}

/// The windows in which views show some ground at all heights of the scene's range.
struct Windows {
  scene::WindowSize size;
  std::vector<WindowPlace> places;
};

/// One where it is small enough, else as few as are, side by side.
/// margin  by which each shows more than it answers for, m
/// most    px a side
Windows windows_for(const scene::Scene& scene, const scene::Polygon& ground, double margin,
                    Index most, Index multiple) {
  constexpr Index kUnlimited = 1 << 20;  // px
  constexpr Index kMostParts = 4;        // within, the middle of the ground has to do
  const Ground box = scene::bounds_of(ground);
  Windows out;
  for (Index parts = 1; parts <= kMostParts; ++parts)
    for (Index columns = 1; columns <= parts; ++columns) {
      if (parts % columns != 0) continue;
      const Index rows = parts / columns;
      out = {};
      for (Index k = 0; k < parts; ++k) {
        const auto part = [](double from, double to, Index of, Index at) {
          return from + (to - from) * static_cast<double>(at) / static_cast<double>(of);
        };
        const Ground answers{part(box.x0, box.x1, columns, k % columns),
                             part(box.y0, box.y1, rows, k / columns),
                             part(box.x0, box.x1, columns, k % columns + 1),
                             part(box.y0, box.y1, rows, k / columns + 1)};
        const scene::Polygon shown =
            scene::intersect(ground, scene::corners_of({answers.x0 - margin, answers.y0 - margin,
                                                        answers.x1 + margin, answers.y1 + margin}));
        if (shown.empty()) continue;
        const scene::GroundWindow window = scene::least_window(scene, shown, kUnlimited, multiple);
        out.size = {std::max(out.size.height, window.size.height),
                    std::max(out.size.width, window.size.width)};
        out.places.push_back({answers, window.middle});
      }
      if (out.size.height <= most && out.size.width <= most) return out;
    }
  const scene::GroundWindow window = scene::least_window(scene, ground, most, multiple);
  return {window.size, {{box, window.middle}}};
}

}  // namespace

Index cells_to_find(const scene::WindowedScene& part, const Tiling& tiling, const Tile& tile,
                    const ReconstructOptions& options,
                    const std::function<Tensor(const Grid&)>& inside) {
  const Grid core = tiling.grid_of(tile.core);
  const Tensor uncounted = not_counted(tiling, tile, of_core(tiling, tile, options.unwanted),
                                       of_core(tiling, tile, inside));
  Index cells = 0;
  for (Index i = 0; i < uncounted.count(); ++i) {
    if (uncounted[i] > 0) continue;
    const double x = core.east + (static_cast<double>(i % core.width) + 0.5) * core.step,
                 y = core.north - (static_cast<double>(i / core.width) + 0.5) * core.step;
    cells += views_showing(part.scene, {x, y, part.scene.z_range.middle()}) >= 2 ? 1 : 0;
  }
  return cells;
}

TileSurface reconstruct_tile(const nn::Model& model, const scene::WindowedScene& part,
                             const Tiling& tiling, const Tile& tile, const Exposures& exposures,
                             const ReconstructOptions& options,
                             const std::function<Tensor(const Grid&)>& inside) {
  TileSurface out;
  const Grid grid = tiling.grid_of(tile.all), core = tiling.grid_of(tile.core);
  const scene::Polygon ground = tiling.ground_of(tile);
  if (part.scene.views.size() < 2 || !any_shown_by_two(part.scene, ground)) return out;
  const Tensor within = of_core(tiling, tile, inside),
               uncounted =
                   not_counted(tiling, tile, of_core(tiling, tile, options.unwanted), within);
  if (std::ranges::all_of(uncounted.values(), [](float v) { return v > 0; })) return out;
  const NoGrad no_grad;
  scene::Scene scene = part.scene;
  scene.z_range = narrowed_range(
      model, scene,
      [&] {
        if (options.progress) options.progress("network", 0);
      },
      options.unwanted);
  ReconstructOptions how = options;
  how.grid = grid, how.look = !looks_first(model.config(), part.scene), how.mesh = {};
  Windows windows = windows_for(scene, ground, static_cast<double>(tiling.overlap) * grid.step,
                                tiling.window, nn::size_multiple(model.config()));
  how.window = windows.size, how.places = std::move(windows.places);
  Reconstruction made = reconstruct(model, scene, how);

  out.empty = false;
  out.z_range = made.z_range, out.camera_fit_max_px = made.camera_fit_max_px;
  out.compared = made.compared, out.agreed = made.agreed, out.levelled = made.levelled;
  out.evened = made.evened;
  out.window = how.window;
  Visibility seen = find_visibility(made.dsm, made.images, exposures.among(part.views));
  out.ortho = orthophoto(made.dsm, made.images, seen,
                         [&](Index i) { return part.values[static_cast<std::size_t>(i)]; });
  const Index y0 = tile.core.y0 - tile.all.y0, x0 = tile.core.x0 - tile.all.x0, h = core.height,
              w = core.width;
  const CellCount cells =
      count_cells({part_of(made.dsm.z, y0, x0, h, w), core.east, core.north, core.step},
                  made.images, scene.z_range.middle(), uncounted);
  out.found = cells.found, out.expected = cells.expected;
  out.surfels = over(delivered_surfels(made), tiling, tile, within);
  out.views = std::move(seen.views);
  out.heights = std::move(made.dsm.z);
  out.confidence = std::move(made.confidence);
  out.sigma = std::move(made.sigma);
  return out;
}

}  // namespace satsurf::reconstruct

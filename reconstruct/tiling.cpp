// SPDX-License-Identifier: Apache-2.0
#include "satsurf/reconstruct/tiling.h"

#include "satsurf/core/error.h"
#include "satsurf/core/memory.h"
#include "satsurf/reconstruct/tile_cut.h"
#include "satsurf/scene/view_geometry.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <string>

namespace satsurf::reconstruct {
namespace {

constexpr Index kOverlap = 32;       // cells; twice as many blend two neighbours
constexpr double kWider = 1.5;       // the range of a tile, of what the fewest hypotheses span
constexpr Index kLeastWindow = 256;  // px; below, hardly anything is left between the overlaps

/// What the program takes beside one tile's work: the reduced copies, the windows of the next tile
/// that are read meanwhile, and the blocks that the readers keep.
/// window  pixels
/// alone   there is no next tile
double memory_around(const ImageSizes& images, double window, bool alone) {
  constexpr double kBlocks = 128e6, kStored = 3;  // bytes, bytes a pixel
  constexpr double kCopy = 2048, kCopied = 20;    // px, bytes a pixel
  constexpr double kAhead = 40;                   // bytes a pixel
  const auto square = [](double side) { return side * side; };
  const double views = static_cast<double>(images.views),
               surveyed = static_cast<double>(std::max(images.views, images.surveyed)),
               side = static_cast<double>(images.largest);
  return std::min(kBlocks, surveyed * kStored * square(side)) +
         surveyed * kCopied * square(std::min(side, kCopy)) + (alone ? 0 : views * kAhead * window);
}

/// window  of every view, px
/// cells   of the surface
/// alone   there is no other tile
double memory_of_tile(const nn::ModelConfig& model, const ImageSizes& images,
                      const scene::WindowSize& window, Surface surface, double cells, bool alone) {
  constexpr double kRepeated = 1.08;  // gaps between the tensors of tiles of different sizes
  const auto area = static_cast<double>(window.count());
  const WorkMemory work = work_memory(model,
                                      {.views = images.views,
                                       .window = window,
                                       .pixels = static_cast<double>(images.views) * area,
                                       .cells = cells,
                                       .parallax = images.parallax},
                                      surface);
  return (alone ? 1 : kRepeated) * (memory_around(images, area, alone) + work.surface_bytes);
}

/// The same of a square window.
/// cells  for each of its pixels
double memory_of_square(const nn::ModelConfig& model, const ImageSizes& images, Index side,
                        Surface surface, double cells) {
  const scene::WindowSize window{side, side};
  return memory_of_tile(model, images, window, surface, cells * static_cast<double>(window.count()),
                        false);
}

/// throws  ConfigError where the least that is needed is more than there may be
void require_room(double bytes, double needed, const ImageSizes& images) {
  if (needed > bytes)
    throw ConfigError("max_memory: " + memory_text(bytes) + ", expected " +
                      std::to_string(static_cast<Index>(std::ceil(needed / 1e6))) +
                      " MB or more for " + std::to_string(images.views) + " images" +
                      " and cells of this size");
}

/// What blending one row of tiles takes.
double memory_of_rows(const Tiling& tiling, bool colour) {
  const double planes = 8 + (colour ? 3 : 1);  // sums and weights of three rasters, views, ortho
  Index tallest = 0;
  for (const Tile& tile : tiling.tiles) tallest = std::max(tallest, tile.all.height());
  return 300e6 + sizeof(float) * planes * static_cast<double>(tiling.grid.width) *
                     static_cast<double>(tallest);
}

/// Tiles in equal columns and rows.
/// throws  Error for more than anybody waits for
void cut(Tiling& tiling, const Cut& how) {
  tiling.axes = how.axes, tiling.columns = how.columns, tiling.rows = how.rows;
  if (static_cast<double>(tiling.columns) * static_cast<double>(tiling.rows) > kMostTiles)
    throw Error("a surface of " + std::to_string(tiling.grid.width) + " x " +
                std::to_string(tiling.grid.height) + " cells in " + std::to_string(tiling.columns) +
                " x " + std::to_string(tiling.rows) +
                " tiles, expected at most a million; wrong cameras?");
  for (Index r = 0; r < tiling.rows; ++r)
    for (Index c = 0; c < tiling.columns; ++c) {
      const Tile tile = tiling.tile(r, c, {how.boundary(0, c), how.boundary(1, r)},
                                    {how.boundary(0, c + 1), how.boundary(1, r + 1)});
      if (tile.core.width() <= 0 || tile.core.height() <= 0) continue;  // beside the grid
      tiling.tiles.push_back(tile);
    }
}

/// The common part of two rectangles; without a span where there is none.
Ground common(const Ground& a, const Ground& b) {
  return {std::max(a.x0, b.x0), std::max(a.y0, b.y0), std::min(a.x1, b.x1), std::min(a.y1, b.y1)};
}

/// What the network is going to see of a tile.
struct Look {
  Index views = 0;
  scene::WindowSize window;  ///< of each, px
  double pixels() const {
    return views < 2 ? 0 : static_cast<double>(views) * static_cast<double>(window.count());
  }
};

/// If the heights of the tile are as far apart as is planned for.
Look look_at(const scene::Survey& survey, const Tiling& tiling, const Tile& tile,
             const std::vector<rpc::PixelJacobian>& cameras, double z_span, Index multiple) {
  const scene::Scene& scene = survey.user.scene;
  const scene::Polygon ground = tiling.ground_of(tile);
  Index views = 0;
  std::array<double, 2> side{};
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    const auto window = scene::window_of(survey.views[i], scene.frame, ground, scene.z_range);
    if (!window) continue;
    ++views;
    for (std::size_t k = 0; k < 2; ++k) {
      const auto& row = cameras[i][k];
      double low = INFINITY, high = -INFINITY;
      for (const auto& [x, y] : ground) {
        const double at = row[0] * x + row[1] * y;
        low = std::min(low, at), high = std::max(high, at);
      }
      double& of = side[k == upright_row(cameras[i]) ? 1 : 0];
      of = std::max(of, std::min(static_cast<double>(k == 0 ? window->width : window->height),
                                 high - low + std::abs(row[2]) * z_span));
    }
  }
  const auto rounded = [&](double px) {
    return std::min(
        tiling.window,
        scene::rounded_up({static_cast<Index>(std::ceil(px + kWindowSlack)), 1}, multiple).height);
  };
  return {std::min(views, tiling.views), {rounded(side[1]), rounded(side[0])}};
}

}  // namespace

TileAxes TileAxes::turned(double degrees) {
  if (degrees == 0) return {};
  const double angle = degrees * std::numbers::pi / 180;
  return {std::cos(angle), std::sin(angle)};
}

double TileAxes::degrees() const { return std::atan2(sine, cosine) * 180 / std::numbers::pi; }

double TileAxes::spread() const {
  const double side = std::abs(cosine) + std::abs(sine);
  return side * side;
}

Grid Tiling::grid_of(const CellRect& cells) const {
  return {grid.east + static_cast<double>(cells.x0) * grid.step,
          grid.north - static_cast<double>(cells.y0) * grid.step, grid.step, cells.height(),
          cells.width()};
}

Tile Tiling::tile(Index row, Index column, const std::array<double, 2>& begin,
                  const std::array<double, 2>& end) const {
  // The cells of the grid whose middles may lie in the rectangle.
  const auto around = [&](double margin) {
    double x0 = INFINITY, y0 = INFINITY, x1 = -INFINITY, y1 = -INFINITY;
    for (const double u : {begin[0] - margin, end[0] + margin})
      for (const double v : {begin[1] - margin, end[1] + margin}) {
        const auto [x, y] = axes.place(u, v);
        x0 = std::min(x0, x), y0 = std::min(y0, y), x1 = std::max(x1, x), y1 = std::max(y1, y);
      }
    const auto cell = [](double at, Index most) {
      return static_cast<Index>(std::clamp(at, 0.0, static_cast<double>(most)));
    };
    return CellRect{cell(std::floor(x0), grid.width), cell(std::floor(y0), grid.height),
                    cell(std::ceil(x1), grid.width), cell(std::ceil(y1), grid.height)};
  };
  return {row, column, around(0), around(static_cast<double>(overlap)), begin, end};
}

scene::Polygon Tiling::corners_of(const Tile& tile, double margin) const {
  const double u0 = tile.begin[0] - margin, v0 = tile.begin[1] - margin, u1 = tile.end[0] + margin,
               v1 = tile.end[1] + margin;
  scene::Polygon corners;
  for (const auto& [u, v] : {std::array{u0, v1}, {u1, v1}, {u1, v0}, {u0, v0}}) {
    const auto [x, y] = axes.place(u, v);
    corners.push_back({grid.east + x * grid.step, grid.north - y * grid.step});
  }
  return corners;
}

scene::Polygon Tiling::ground_of(const Tile& tile) const {
  const scene::Polygon box = scene::corners_of(grid_of(tile.all).ground());
  if (axes.sine == 0) return box;
  return scene::intersect(corners_of(tile, static_cast<double>(overlap)), box);
}

namespace {

bool holds(const Tile& tile, const std::array<double, 2>& at) {
  return at[0] >= tile.begin[0] && at[0] < tile.end[0] && at[1] >= tile.begin[1] &&
         at[1] < tile.end[1];
}

}  // namespace

bool Tiling::owns(const Tile& tile, Index x, Index y) const {
  return holds(tile, axes.along(static_cast<double>(x) + 0.5, static_cast<double>(y) + 0.5));
}

bool Tiling::owns_place(const Tile& tile, double x, double y) const {
  return holds(tile, axes.along((x - grid.east) / grid.step, (grid.north - y) / grid.step));
}

double Tiling::weight(const Tile& tile, Index x, Index y) const {
  const auto at = axes.along(static_cast<double>(x) + 0.5, static_cast<double>(y) + 0.5);
  const auto ramp = [&](double from) {  // cells from where the other tile begins to fade
    return std::clamp(from / (2 * static_cast<double>(overlap)), 0.0, 1.0);
  };
  // Beyond the outermost tiles nobody answers for anything.
  const auto along = [&](std::size_t axis, Index part, Index parts) {
    const auto margin = static_cast<double>(overlap);
    const double before = at[axis] - tile.begin[axis], after = tile.end[axis] - at[axis];
    const auto side = [&](double inside, bool outermost) {
      return outermost || overlap == 0 ? (inside >= 0 ? 1.0 : 0.0) : ramp(inside + margin);
    };
    return std::min(side(before, part == 0), side(after, part + 1 == parts));
  };
  return along(1, tile.row, rows) * along(0, tile.column, columns);
}

Index window_for_memory(const nn::ModelConfig& model, const ImageSizes& images, Surface surface,
                        double bytes, double cells) {
  const Index multiple = nn::size_multiple(model);
  const Index least = (kLeastWindow + multiple - 1) / multiple * multiple;
  if (!(bytes > 0)) return std::max(least, kWholeImage / multiple * multiple);
  Index window = std::max(least, kLargestWindow / multiple * multiple);
  while (window > least && memory_of_square(model, images, window, surface, cells) > bytes)
    window -= multiple;
  require_room(bytes, memory_of_square(model, images, window, surface, cells), images);
  return window;
}

Tiling plan_tiles(const nn::ModelConfig& model, const scene::Survey& survey,
                  const ReconstructOptions& options, const std::optional<Ground>& wanted) {
  const double max_memory = options.max_memory;
  const scene::Scene& scene = survey.user.scene;
  const auto surveyed = static_cast<Index>(survey.views.size());
  const Surface surface = surface_kind(options);
  scene::Polygon seen = common_outline(scene);
  Ground ground = scene::bounds_of(seen);
  if (wanted) {
    ground = common(ground, *wanted);
    seen = scene::intersect(seen, scene::corners_of(*wanted));
  }
  if (!(ground.width() > 0 && ground.height() > 0))
    throw Error(
        "the part of the ground that is wanted lies outside of what two images see, "
        "expected a part of it; see satsurf info");
  const std::array<double, 3> middle{0.5 * (ground.x0 + ground.x1), 0.5 * (ground.y0 + ground.y1),
                                     scene.z_range.middle()};
  const std::vector<rpc::PixelJacobian> cameras =
      scene::cameras_at(survey.views, scene.frame, middle);
  const double footprint = mean_footprint(cameras);
  Tiling out;
  out.views = std::min(surveyed, survey.most_views);
  out.grid = grid_of(ground, scene.frame,
                     options.resolution > 0 ? options.resolution : natural_step(footprint));
  out.overlap = kOverlap;
  ImageSizes images{.views = out.views, .surveyed = surveyed};
  for (const scene::SurveyedView& view : survey.views)
    images.largest = std::max({images.largest, view.width, view.height});

  // A tile's own range, which is narrowed, is hardly ever more.
  const double span = std::min(scene.z_range.span(), kWider * span_of_hypotheses(model, cameras));
  images.parallax = mean_parallax(cameras) * span;
  CutRules rules{.grid = out.grid,
                 .cameras = cameras,
                 .seen = seen,
                 .z_span = span,
                 .overlap = out.overlap,
                 .window = window_for_memory(model, images, surface, max_memory),
                 .multiple = nn::size_multiple(model)};
  Cut how = best_direction(rules);
  // Cells of the surface for each pixel of a window.
  const auto cells = [&] {
    return how.cells_of_tile(out.overlap) /
           (static_cast<double>(rules.window) * static_cast<double>(rules.window));
  };
  if (max_memory > 0) {
    rules.window = window_for_memory(model, images, surface, max_memory, cells());
    for (;; rules.window -= rules.multiple) {
      how = best_cut(rules, how.axes);
      const double needed = memory_of_square(model, images, rules.window, surface, cells());
      if (needed <= max_memory) break;
      if (rules.window <= kLeastWindow) require_room(max_memory, needed, images);
    }
  }
  out.window = rules.window;
  cut(out, how);
  for (const Tile& tile : out.tiles) {
    const Look look = look_at(survey, out, tile, cameras, span, rules.multiple);
    out.megapixels += 1e-6 * look.pixels();
    const double bytes = memory_of_tile(
        model, images, look.window, surface,
        static_cast<double>(tile.all.width()) * static_cast<double>(tile.all.height()),
        out.tiles.size() == 1);
    if (bytes > out.memory_bytes) out.memory_bytes = bytes, out.expected_window = look.window;
  }
  out.memory_bytes = std::max(out.memory_bytes, memory_of_rows(out, survey.colour));
  return out;
}

}  // namespace satsurf::reconstruct

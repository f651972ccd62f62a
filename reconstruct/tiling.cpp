// SPDX-License-Identifier: Apache-2.0
#include "satsurf/reconstruct/tiling.h"

#include "satsurf/core/error.h"
#include "satsurf/core/memory.h"
#include "satsurf/rpc/fit.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <string>

namespace satsurf::reconstruct {
namespace {

constexpr Index kOverlap = 32;  // cells; twice as many blend two neighbours
constexpr Index kSlack = 8;     // px of a window for rounding and interpolation
constexpr double kLocal = 0.2;  // of a window, for the parallax of a tile's heights
constexpr double kMostTiles = 1e6;
constexpr Index kLeastWindow = 256;  // px; below, hardly anything is left between the overlaps

/// What the program takes beside one tile's work: the reduced copies, the windows of the next tile
/// that are read meanwhile, and the blocks that the readers keep.
double memory_around(const ImageSizes& images, Index window) {
  constexpr double kBlocks = 128e6, kStored = 3;  // bytes, bytes a pixel
  constexpr double kCopy = 2048, kCopied = 20;    // px, bytes a pixel
  constexpr double kAhead = 40;                   // bytes a pixel
  const auto square = [](double side) { return side * side; };
  const double views = static_cast<double>(images.views),
               surveyed = static_cast<double>(std::max(images.views, images.surveyed)),
               side = static_cast<double>(images.largest);
  return std::min(kBlocks, surveyed * kStored * square(side)) +
         surveyed * kCopied * square(std::min(side, kCopy)) +
         views * kAhead * square(static_cast<double>(window));
}

double memory_of_tile(const nn::ModelConfig& model, const ImageSizes& images, Index window,
                      Surface surface) {
  constexpr double kRepeated = 1.08;  // gaps between the tensors of tiles of different sizes
  const double area = static_cast<double>(window) * static_cast<double>(window);
  const WorkMemory work = work_memory(model,
                                      {.views = images.views,
                                       .window = {window, window},
                                       .pixels = static_cast<double>(images.views) * area,
                                       .cells = area},
                                      surface);
  return kRepeated * (memory_around(images, window) + work.bytes);
}

/// What blending one row of tiles takes.
double memory_of_rows(const Tiling& tiling, bool colour) {
  const double planes = 8 + (colour ? 3 : 1);  // sums and weights of three rasters, views, ortho
  Index tallest = 0;
  for (const Tile& tile : tiling.tiles) tallest = std::max(tallest, tile.all.height());
  return 300e6 + sizeof(float) * planes * static_cast<double>(tiling.grid.width) *
                     static_cast<double>(tallest + 2 * tiling.overlap);
}

/// Where the parts of a side begin and end.
Index boundary(Index cells, Index parts, Index k) { return cells * k / parts; }

/// One axis of a view's window: pixels along it that a column and a row of the surface's cells take,
/// and how many of them cells may take, the rest being for the heights.
struct Axis {
  double column = 0, row = 0, room = 0;
  bool upright = false;  ///< the window's rows, north up
};

/// Which row of a camera's derivatives is the axis of north, see `scene::quarters_to_north`.
std::size_t upright_row(const rpc::PixelJacobian& camera) {
  return std::abs(camera[1][1]) >= std::abs(camera[0][1]) ? 1 : 0;
}

/// Parts of a side whose cores leave room for the overlap.
/// most  cells of a part
Index parts_of(Index cells, double most, Index overlap) {
  if (static_cast<double>(cells) <= most) return 1;
  // A window of NaN holds no cell.
  const auto core = most >= static_cast<double>(4 * overlap)
                        ? static_cast<Index>(most) - 2 * overlap
                        : 2 * overlap;
  return (cells + core - 1) / core;
}

/// The columns and rows of tiles that need the fewest pixels of windows. Tiles are the longer, the
/// less of the window the heights take along them.
/// window    px
/// multiple  of what windows are, px
std::array<Index, 2> best_cut(const Grid& grid, Index overlap, const std::vector<Axis>& axes,
                              Index window, Index multiple) {
  const auto cells_of = [&](Index side, Index parts) {
    return static_cast<double>(side) / static_cast<double>(parts) +
           static_cast<double>(parts > 1 ? 2 * overlap : 0);
  };
  double widest = INFINITY;
  for (const Axis& axis : axes) widest = std::min(widest, axis.room / axis.column);
  const Index first = parts_of(grid.width, widest, overlap);
  std::array<Index, 2> best{first, 0};
  double least = INFINITY;
  for (Index columns = first; columns <= 4 * first + 4; ++columns) {
    const double wide = cells_of(grid.width, columns);
    double highest = INFINITY;
    for (const Axis& axis : axes)
      highest = std::min(highest, (axis.room - axis.column * wide) / axis.row);
    const Index rows = parts_of(grid.height, highest, overlap);
    const double high = cells_of(grid.height, rows);
    std::array<double, 2> side{};
    for (const Axis& axis : axes) {
      double& of = side[axis.upright ? 1 : 0];
      of = std::max(of,
                    axis.column * wide + axis.row * high + static_cast<double>(window) - axis.room);
    }
    const double of = static_cast<double>(multiple);
    const double cost = static_cast<double>(columns) * static_cast<double>(rows) *
                        std::ceil(side[0] / of) * std::ceil(side[1] / of);
    if (cost < least || best[1] == 0) least = cost, best = {columns, rows};
    if (2 * overlap >= grid.width / columns || static_cast<double>(columns) > kMostTiles) break;
  }
  return best;
}

/// Tiles of a grid in equal columns and rows.
/// throws  Error for more than anybody waits for
void cut(Tiling& tiling, Index columns, Index rows) {
  const Index W = tiling.grid.width, H = tiling.grid.height, m = tiling.overlap;
  tiling.columns = columns, tiling.rows = rows;
  if (static_cast<double>(tiling.columns) * static_cast<double>(tiling.rows) > kMostTiles)
    throw Error("a surface of " + std::to_string(W) + " x " + std::to_string(H) + " cells in " +
                std::to_string(tiling.columns) + " x " + std::to_string(tiling.rows) +
                " tiles, expected at most a million; wrong cameras?");
  for (Index r = 0; r < tiling.rows; ++r)
    for (Index c = 0; c < tiling.columns; ++c) {
      const CellRect core{boundary(W, tiling.columns, c), boundary(H, tiling.rows, r),
                          boundary(W, tiling.columns, c + 1), boundary(H, tiling.rows, r + 1)};
      tiling.tiles.push_back({r,
                              c,
                              core,
                              {std::max<Index>(0, core.x0 - m), std::max<Index>(0, core.y0 - m),
                               std::min(W, core.x1 + m), std::min(H, core.y1 + m)}});
    }
}

/// The common part of two rectangles; without a span where there is none.
Ground common(const Ground& a, const Ground& b) {
  return {std::max(a.x0, b.x0), std::max(a.y0, b.y0), std::min(a.x1, b.x1), std::min(a.y1, b.y1)};
}

/// Pixels the network looks at, of the views that show a tile.
double pixels_of(const scene::Survey& survey, const Tiling& tiling, const Tile& tile,
                 const std::vector<rpc::PixelJacobian>& cameras, double z_span, Index multiple) {
  const scene::Scene& scene = survey.user.scene;
  const Ground ground = tiling.grid_of(tile.all).ground();
  Index views = 0;
  std::array<double, 2> side{};
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    if (!scene::window_of(survey.views[i], scene.frame, ground, scene.z_range)) continue;
    ++views;
    for (std::size_t k = 0; k < 2; ++k) {
      const auto& row = cameras[i][k];
      double& of = side[k == upright_row(cameras[i]) ? 1 : 0];
      of = std::max(of, std::abs(row[0]) * ground.width() + std::abs(row[1]) * ground.height() +
                            std::abs(row[2]) * z_span);
    }
  }
  if (views < 2) return 0;
  views = std::min(views, tiling.views);
  const double most = static_cast<double>(tiling.window), of = static_cast<double>(multiple);
  for (double& s : side) s = std::min(most, std::ceil((s + kSlack) / of) * of);
  return static_cast<double>(views) * side[0] * side[1];
}

}  // namespace

Grid Tiling::grid_of(const CellRect& cells) const {
  return {grid.east + static_cast<double>(cells.x0) * grid.step,
          grid.north - static_cast<double>(cells.y0) * grid.step, grid.step, cells.height(),
          cells.width()};
}

Index window_for_memory(const nn::ModelConfig& model, const ImageSizes& images, Surface surface,
                        double bytes) {
  const Index multiple = nn::size_multiple(model);
  const Index least = (kLeastWindow + multiple - 1) / multiple * multiple;
  if (!(bytes > 0)) return std::max(least, kWholeImage / multiple * multiple);
  Index window = std::max(least, kLargestWindow / multiple * multiple);
  while (window > least && memory_of_tile(model, images, window, surface) > bytes)
    window -= multiple;
  const double needed = memory_of_tile(model, images, window, surface);
  if (needed > bytes)
    throw ConfigError("max_memory: " + memory_text(bytes) + ", expected " +
                      std::to_string(static_cast<Index>(std::ceil(needed / 1e6))) +
                      " MB or more for " + std::to_string(images.views) + " images");
  return window;
}

Tiling plan_tiles(const nn::ModelConfig& model, const scene::Survey& survey,
                  const ReconstructOptions& options, const std::optional<Ground>& wanted,
                  double max_memory) {
  const scene::Scene& scene = survey.user.scene;
  const auto surveyed = static_cast<Index>(survey.views.size());
  const Surface surface = surface_kind(options);
  Ground ground = common_ground(scene);
  if (wanted) ground = common(ground, *wanted);
  if (!(ground.width() > 0 && ground.height() > 0))
    throw Error(
        "the part of the ground that is wanted lies outside of what two images see, "
        "expected a part of it; see satsurf info");
  const std::array<double, 3> middle{0.5 * (ground.x0 + ground.x1), 0.5 * (ground.y0 + ground.y1),
                                     scene.z_range.middle()};
  std::vector<rpc::PixelJacobian> cameras;
  double footprint = 0;
  for (const scene::SurveyedView& view : survey.views) {
    cameras.push_back(rpc::pixel_jacobian(view.rpc, scene.frame, middle));
    footprint += rpc::view_geometry(cameras.back()).footprint / static_cast<double>(surveyed);
  }
  Tiling out;
  out.views = std::min(surveyed, survey.most_views);
  out.grid = grid_of(ground, scene.frame,
                     options.resolution > 0 ? options.resolution : natural_step(footprint));
  out.overlap = kOverlap;
  ImageSizes images{.views = out.views, .surveyed = surveyed};
  for (const scene::SurveyedView& view : survey.views)
    images.largest = std::max({images.largest, view.width, view.height});
  out.window = window_for_memory(model, images, surface, max_memory);

  const auto S = static_cast<double>(out.window - kSlack);
  std::vector<Axis> axes;
  for (const rpc::PixelJacobian& camera : cameras)
    for (std::size_t k = 0; k < 2; ++k)
      axes.push_back({std::abs(camera[k][0]) * out.grid.step,
                      std::abs(camera[k][1]) * out.grid.step,
                      std::max(S - std::abs(camera[k][2]) * scene.z_range.span(), (1 - kLocal) * S),
                      k == upright_row(camera)});
  const auto [columns, rows] =
      best_cut(out.grid, out.overlap, axes, out.window, nn::size_multiple(model));
  cut(out, columns, rows);
  double local = 0;  // of the range what windows have room for
  for (const rpc::PixelJacobian& camera : cameras)
    for (const auto& row : camera) local = std::max(local, std::abs(row[2]));
  const double span = std::min(scene.z_range.span(), kLocal * S / std::max(local, 1e-9));
  for (const Tile& tile : out.tiles)
    out.megapixels += 1e-6 * pixels_of(survey, out, tile, cameras, span, nn::size_multiple(model));
  out.memory_bytes = std::max(memory_of_tile(model, images, out.window, surface),
                              memory_of_rows(out, survey.colour));
  return out;
}

}  // namespace satsurf::reconstruct

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/reconstruct/plan.h"

#include "satsurf/core/block_pool.h"
#include "satsurf/core/error.h"
#include "satsurf/core/memory.h"
#include "satsurf/nn/hypotheses.h"
#include "satsurf/scene/view_geometry.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <sstream>
#include <utility>

namespace satsurf::reconstruct {
namespace {

constexpr Index kTile = 768;               // px; keeps the largest volume near 0.3 GB
constexpr double kMostCells = 2147483647;  // a side, as rasters count them
constexpr double kMostTiles = 1e6;

/// The corners, the middles of the sides and the middle of an image.
std::array<rpc::Pixel, 9> outline(const scene::View& v) {
  std::array<rpc::Pixel, 9> pixels;
  std::size_t k = 0;
  for (const double fx : {0.0, 0.5, 1.0})
    for (const double fy : {0.0, 0.5, 1.0})
      pixels[k++] = {fx * static_cast<double>(v.width()) - 0.5,
                     fy * static_cast<double>(v.height()) - 0.5};
  return pixels;
}

/// Around what at least two views see at any of some heights; empty where there is no such ground.
/// sees  how many do at a point, local m
template <class F>
scene::Polygon common_outline(const scene::Scene& scene, std::span<const double> heights,
                              F&& sees) {
  constexpr Index kGrid = 128;
  std::vector<std::array<double, 2>> corners;
  for (const double z : heights) {
    Ground all{INFINITY, INFINITY, -INFINITY, -INFINITY};
    for (const scene::View& v : scene.views)
      for (const rpc::Pixel& pixel : outline(v)) {
        const auto p = scene.frame.local_from_geodetic(v.rpc.localize(pixel, z + scene.frame.h0));
        all = {std::min(all.x0, p[0]), std::min(all.y0, p[1]), std::max(all.x1, p[0]),
               std::max(all.y1, p[1])};
      }
    const double dx = all.width() / kGrid, dy = all.height() / kGrid;
    for (Index i = 0; i < kGrid; ++i) {
      const double y = all.y0 + (static_cast<double>(i) + 0.5) * dy;
      const auto middle = [&](Index j) { return all.x0 + (static_cast<double>(j) + 0.5) * dx; };
      const auto seen = [&](Index j) { return sees(std::array{middle(j), y, z}) >= 2; };
      Index first = 0, last = kGrid - 1;  // all that is between them lies in their hull
      while (first < kGrid && !seen(first)) ++first;
      if (first == kGrid) continue;
      while (!seen(last)) --last;
      for (const double x : {middle(first) - dx / 2, middle(last) + dx / 2})
        for (const double v : {y - dy / 2, y + dy / 2}) corners.push_back({x, v});
    }
  }
  return scene::convex_hull(std::move(corners));
}

}  // namespace

scene::Polygon outline_of_two(const scene::Scene& scene, std::span<const double> heights) {
  return common_outline(scene, heights, [&](const auto& p) { return views_showing(scene, p); });
}

scene::Polygon common_outline(const scene::Scene& scene) {
  const std::array z{scene.z_range.middle()};
  scene::Polygon common = outline_of_two(scene, z);
  if (common.empty())
    common = common_outline(scene, z, [&](const auto& p) {
      const rpc::Geodetic at = scene.frame.geodetic_from_local(p);
      return std::ranges::count_if(scene.views,
                                   [&](const scene::View& v) { return v.contains(at); });
    });
  if (common.empty()) throw Error("no two images see the same ground, expected overlapping views");
  return common;
}

Ground common_ground(const scene::Scene& scene) { return scene::bounds_of(common_outline(scene)); }

Grid grid_of(const Ground& ground, const rpc::LocalFrame& frame, double step,
             const std::array<double, 2>& corner) {
  const double columns = ground.width() / step, rows = ground.height() / step;
  if (!(step > 0 && columns < kMostCells && rows < kMostCells)) {
    std::ostringstream text;
    text << "a surface of " << ground.width() << " x " << ground.height() << " m in cells of "
         << step << " m, expected fewer than 2^31 cells a side; wrong cameras?";
    throw Error(text.str());
  }
  Grid grid;
  grid.step = step;
  const double east = frame.easting0 - corner[0], north = frame.northing0 - corner[1];
  grid.east = std::floor((ground.x0 + east) / step) * step - east;
  grid.north = std::ceil((ground.y1 + north) / step) * step - north;
  grid.width = std::max<Index>(1, static_cast<Index>(std::ceil((ground.x1 - grid.east) / step)));
  grid.height = std::max<Index>(1, static_cast<Index>(std::ceil((grid.north - ground.y0) / step)));
  return grid;
}

double natural_step(double footprint) { return std::max(0.05, std::round(footprint * 20) / 20); }

namespace {

/// About what two views are going to show of the surface, at its own heights, which nobody knows yet:
/// around the height, of some in the range, at which they share most ground, as images of one place do
/// where it is.
/// otherwise  where they share none at all
Ground expected_ground(const scene::Scene& scene, const Ground& otherwise) {
  constexpr double kRelief = 15;  // m on either side
  const auto area = [](const Ground& g) { return g.width() * g.height(); };
  const rpc::HeightRange& range = scene.z_range;
  const double away = std::min(kRelief, range.span() / 4);
  Ground most;
  double where = 0;
  for (const double z : {range.low + away, range.middle(), range.high - away})
    if (const scene::Polygon outline = outline_of_two(scene, std::array{z}); !outline.empty())
      if (const Ground ground = scene::bounds_of(outline); area(ground) > area(most))
        most = ground, where = z;
  return area(most) > 0 ? scene::bounds_of(
                              outline_of_two(scene, std::array{where - away, where, where + away}))
                        : otherwise;
}

/// Side of the largest ground square that every view's window holds for every height of the range.
/// window   side of the windows, px
/// cameras  derivatives of the views in the middle of the ground
double tile_side(Index window, const std::vector<rpc::PixelJacobian>& cameras, double z_span) {
  const double S = static_cast<double>(window);
  double side = INFINITY;
  for (const rpc::PixelJacobian& camera : cameras)
    for (const auto& row : camera) {
      const double room = std::max(S - std::abs(row[2]) * z_span, 0.25 * S);
      side = std::min(side, room / (std::abs(row[0]) + std::abs(row[1])));
    }
  return side;
}

/// Equal tiles that cover a ground, row by row from the south-west.
/// throws  Error for more than anybody waits for
std::vector<Ground> tiles_of(const Ground& ground, double side) {
  if (!(side > 0 && (1 + ground.width() / side) * (1 + ground.height() / side) < kMostTiles)) {
    std::ostringstream text;
    text << "a ground of " << ground.width() << " x " << ground.height() << " m in tiles of "
         << side << " m, expected fewer than a million; wrong cameras?";
    throw Error(text.str());
  }
  const Index columns = std::max<Index>(1, static_cast<Index>(std::ceil(ground.width() / side))),
              rows = std::max<Index>(1, static_cast<Index>(std::ceil(ground.height() / side)));
  const double w = ground.width() / static_cast<double>(columns),
               h = ground.height() / static_cast<double>(rows);
  std::vector<Ground> tiles;
  for (Index r = 0; r < rows; ++r)
    for (Index c = 0; c < columns; ++c) {
      const double x = ground.x0 + static_cast<double>(c) * w,
                   y = ground.y0 + static_cast<double>(r) * h;
      tiles.push_back({x, y, x + w, y + h});
    }
  return tiles;
}

}  // namespace

WorkMemory work_memory(const nn::ModelConfig& model, const WorkSize& size, Surface surface) {
  constexpr double kProgram = 150e6;             // code, libraries and weights
  constexpr double kKept = 1.2;                  // tensors, with freed ones that wait for reuse
  constexpr double kView = 4, kSurfel = 14;      // floats a pixel, floats a surfel
  constexpr double kSplat = 24, kMaps = 19;      // floats a surfel, floats a cell, to render
  constexpr double kLists = 21;                  // floats a surfel, beside the tensors
  constexpr double kFuse = 18, kFused = 5;       // floats a surfel, floats a cell, to fuse
  constexpr double kRefine = 3, kRefined = 163;  // alike, to refine
  constexpr double kHeights = 9, kMesh = 84;     // floats a pixel, floats a column of voxels
  constexpr int kWorkers = 16;  // whatever there are: sizes of tiles must not depend on them
  const Index views = size.views;
  const double pixels = size.pixels, cells = size.cells;
  const Index height = size.window.height, width = size.window.width;
  const double window = static_cast<double>(size.window.count()) * static_cast<double>(views);
  const nn::Wanted wanted = wanted_of(surface);
  nn::ModelConfig searching = model;
  if (wanted != nn::Wanted::surfels)
    searching.hypotheses[0] = nn::first_hypotheses(model, size.parallax);
  std::vector<nn::PartMemory> parts =
      nn::forward_memory(searching, views, height, width, wanted, kWorkers);
  const double network =
      nn::forward_bytes(searching, views, height, width, wanted, kWorkers) +
      sizeof(float) * (kView * window + kSurfel * (pixels - std::min(pixels, window)));
  const double render =
      sizeof(float) * (surface == Surface::splat     ? kSplat * pixels + kMaps * cells
                       : surface == Surface::refined ? kRefine * pixels + kRefined * cells
                                                     : kFuse * pixels + kFused * cells);
  parts.push_back({"surface", render});
  const auto program = [&](double most) {
    return kProgram + kKept * (sizeof(float) * kView * pixels + most);
  };
  const double mesh = sizeof(float) * ((kSurfel + kHeights) * pixels + kMesh * size.columns);
  return {program(std::max(network, render + sizeof(float) * kLists * pixels)),
          size.columns > 0 ? program(mesh) : 0, std::move(parts)};
}

Surface surface_kind(const ReconstructOptions& options) {
  if (options.surface == Surface::automatic)
    return options.network != nullptr ? Surface::refined : Surface::splat;
  if (options.surface == Surface::refined && options.network == nullptr)
    throw ConfigError("surface is refined, expected weights with a surface network");
  return options.surface;
}

nn::Wanted wanted_of(Surface surface) {
  return surface == Surface::refined ? nn::Wanted::discs : nn::Wanted::surfels;
}

double mean_footprint(const std::vector<rpc::PixelJacobian>& cameras) {
  double sum = 0;
  for (const rpc::PixelJacobian& camera : cameras) sum += rpc::view_geometry(camera).footprint;
  return sum / static_cast<double>(cameras.size());
}

ReconstructPlan plan_reconstruction(const nn::ModelConfig& model, const scene::Scene& scene,
                                    const ReconstructOptions& options) {
  const double z = scene.z_range.middle();
  ReconstructPlan plan;
  plan.z_range = scene.z_range;
  plan.ground = options.grid ? options.grid->ground() : common_ground(scene);
  const Ground& ground = plan.ground;
  const std::array<double, 3> middle{0.5 * (ground.x0 + ground.x1), 0.5 * (ground.y0 + ground.y1),
                                     z};
  const std::vector<rpc::PixelJacobian> cameras =
      scene::cameras_at(scene.views, scene.frame, middle);
  Index largest = 0;
  for (const scene::View& v : scene.views) largest = std::max({largest, v.height(), v.width()});
  const double footprint = mean_footprint(cameras);

  const Index multiple = nn::size_multiple(model);
  plan.whole_images = !options.grid && options.tile == 0 && largest <= kWholeImage;
  const Index side = plan.whole_images ? largest : options.tile > 0 ? options.tile : kTile;
  const bool given = options.grid && options.window.count() > 0;
  plan.window =
      plan.whole_images
          ? scene::window_around(scene, ground, side, multiple)
          : scene::rounded_up(given ? options.window : scene::WindowSize{side, side}, multiple);
  plan.tiles = plan.whole_images || options.grid
                   ? std::vector<Ground>{ground}
                   : tiles_of(ground, tile_side(plan.window.height, cameras, scene.z_range.span()));

  for (const Ground& tile : plan.tiles)
    plan.middles.push_back({0.5 * (tile.x0 + tile.x1), 0.5 * (tile.y0 + tile.y1), z});
  if (given && !options.places.empty()) {
    plan.tiles.clear(), plan.middles.clear();
    for (const WindowPlace& place : options.places)
      plan.tiles.push_back(place.answers), plan.middles.push_back(place.middle);
  }

  const double step = options.resolution > 0 ? options.resolution : natural_step(footprint);
  plan.grid = options.grid
                  ? *options.grid
                  : grid_of(expected_ground(scene, ground), scene.frame, step, options.cell_corner);
  if (options.mesh)
    plan.voxel =
        *options.mesh > 0 ? *options.mesh : std::max(0.05, std::round(40 * footprint) / 20);
  WorkSize size{.views = static_cast<Index>(scene.views.size()),
                .window = plan.window,
                .cells = plan.grid.cells(),
                .parallax = mean_parallax(cameras) * scene.z_range.span()};
  plan.megapixels = 1e-6 * static_cast<double>(plan.window.count()) *
                    static_cast<double>(size.views) * static_cast<double>(plan.middles.size());
  for (const scene::View& v : scene.views) size.pixels += static_cast<double>(v.valid.count());
  if (plan.voxel > 0)
    size.columns = size.cells * plan.grid.step * plan.grid.step / (plan.voxel * plan.voxel);
  plan.columns = size.columns;
  WorkMemory memory = work_memory(model, size, surface_kind(options));
  plan.surface_bytes = memory.surface_bytes, plan.mesh_bytes = memory.mesh_bytes;
  const bool with_mesh = options.max_memory == 0 || plan.mesh_bytes <= options.max_memory;
  plan.memory_bytes = std::max(plan.surface_bytes, with_mesh ? plan.mesh_bytes : 0.0);
  plan.memory = std::move(memory.parts);
  return plan;
}

double mean_parallax(const std::vector<rpc::PixelJacobian>& cameras) {
  double sum = 0;
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    const auto [east, north, up] = rpc::view_geometry(cameras[i]).direction;  // along i's ray
    for (std::size_t j = 0; j < cameras.size(); ++j) {
      const rpc::PixelJacobian& c = cameras[j];
      if (j != i)
        sum += std::hypot(c[0][0] * east + c[0][1] * north + c[0][2] * up,
                          c[1][0] * east + c[1][1] * north + c[1][2] * up);
    }
  }
  return sum / static_cast<double>(cameras.size() * (cameras.size() - 1));
}

double span_of_hypotheses(const nn::ModelConfig& config,
                          const std::vector<rpc::PixelJacobian>& cameras) {
  return config.first_interval_px * static_cast<double>(nn::kStrides[0] * config.hypotheses[0]) /
         mean_parallax(cameras);
}

void check_memory(const ReconstructPlan& plan, const scene::Scene& scene) {
  const auto times = [](Index a, Index b) { return std::to_string(a) + " x " + std::to_string(b); };
  satsurf::check_memory(std::to_string(scene.views.size()) + " windows of " +
                            times(plan.window.width, plan.window.height) + " px and a surface of " +
                            times(plan.grid.width, plan.grid.height) + " cells need",
                        plan.surface_bytes, "give smaller images or a coarser resolution",
                        static_cast<double>(tensor_bytes()));  // the images are read
}

Index views_showing(const scene::Scene& scene, const std::array<double, 3>& p_in_local) {
  const rpc::Geodetic p = scene.frame.geodetic_from_local(p_in_local);
  return std::ranges::count_if(scene.views, [&](const scene::View& v) { return v.shows(p); });
}

}  // namespace satsurf::reconstruct

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/reconstruct/reconstruct.h"

#include "satsurf/core/block_pool.h"
#include "satsurf/core/memory.h"
#include "satsurf/core/parallel.h"
#include "satsurf/nn/surfel_head.h"
#include "satsurf/splat/select.h"
#include "satsurf/splat/view.h"

#include <algorithm>
#include <cmath>
#include <string>

namespace satsurf::reconstruct {
namespace {

constexpr Index kWholeImage = 1280;  // px; larger images are cut into tiles
constexpr Index kTile = 768;         // px; keeps the largest volume near 0.3 GB
constexpr double kAgreement = 2.5;   // m, between the heights two views give one point

bool inside(const scene::View& view, const rpc::Pixel& p) {
  return p.x >= -0.5 && p.y >= -0.5 && p.x <= static_cast<double>(view.rgb.dim(2)) - 0.5 &&
         p.y <= static_cast<double>(view.rgb.dim(1)) - 0.5;
}

Index views_seeing(const scene::Scene& scene, double x, double y, double z) {
  const rpc::Geodetic p = scene.frame.geodetic_from_local({x, y, z});
  Index n = 0;
  for (const scene::View& v : scene.views) n += inside(v, v.rpc.project(p)) ? 1 : 0;
  return n;
}

/// What at least two views see at the middle height.
Ground common_ground(const scene::Scene& scene, double z) {
  Ground all{INFINITY, INFINITY, -INFINITY, -INFINITY};
  for (const scene::View& v : scene.views)
    for (const double fx : {0.0, 0.5, 1.0})
      for (const double fy : {0.0, 0.5, 1.0}) {
        const rpc::Pixel corner{fx * static_cast<double>(v.rgb.dim(2)) - 0.5,
                                fy * static_cast<double>(v.rgb.dim(1)) - 0.5};
        const auto p = scene.frame.local_from_geodetic(v.rpc.localize(corner, z + scene.frame.h0));
        all = {std::min(all.x0, p[0]), std::min(all.y0, p[1]), std::max(all.x1, p[0]),
               std::max(all.y1, p[1])};
      }
  // fine enough to place tiles; the exact rim comes from the surfels themselves
  constexpr Index kGrid = 128;
  Ground common{INFINITY, INFINITY, -INFINITY, -INFINITY};
  const double dx = all.width() / kGrid, dy = all.height() / kGrid;
  for (Index i = 0; i < kGrid; ++i)
    for (Index j = 0; j < kGrid; ++j) {
      const double x = all.x0 + (static_cast<double>(j) + 0.5) * dx,
                   y = all.y0 + (static_cast<double>(i) + 0.5) * dy;
      if (views_seeing(scene, x, y, z) < 2) continue;
      common = {std::min(common.x0, x - dx / 2), std::min(common.y0, y - dy / 2),
                std::max(common.x1, x + dx / 2), std::max(common.y1, y + dy / 2)};
    }
  if (!(common.width() > 0))
    throw Error("reconstruct: no two images see the same ground, expected overlapping views");
  return common;
}

/// d(pixel)/d(local) of a view at a ground point.
std::array<std::array<double, 3>, 2> pixel_jacobian(const scene::Scene& scene,
                                                    const scene::View& view, double x, double y,
                                                    double z) {
  constexpr double kStep = 1;  // m; the map is linear to 1e-6 over this distance
  std::array<std::array<double, 3>, 2> j{};
  for (std::size_t a = 0; a < 3; ++a) {
    std::array<double, 3> low{x, y, z}, high{x, y, z};
    low[a] -= kStep;
    high[a] += kStep;
    const rpc::Pixel p0 = view.rpc.project(scene.frame.geodetic_from_local(low)),
                     p1 = view.rpc.project(scene.frame.geodetic_from_local(high));
    j[0][a] = (p1.x - p0.x) / (2 * kStep);
    j[1][a] = (p1.y - p0.y) / (2 * kStep);
  }
  return j;
}

/// Network windows and the ground each answers for.
void plan_tiles(ReconstructPlan& plan, const scene::Scene& scene, double z, Index asked,
                Index multiple) {
  const Ground& ground = plan.ground;
  const auto round_up = [multiple](Index n) { return (n + multiple - 1) / multiple * multiple; };
  Index largest = 0;
  for (const scene::View& v : scene.views)
    largest = std::max({largest, v.rgb.dim(1), v.rgb.dim(2)});
  if (asked == 0 && largest <= kWholeImage) {
    plan.window = round_up(largest);
    plan.tiles = {ground};
    return;
  }
  plan.window = round_up(asked > 0 ? asked : kTile);
  // The largest ground square that every view's window holds for every height of the range.
  double side = INFINITY;
  const double S = static_cast<double>(plan.window), span = scene.z_high - scene.z_low;
  for (const scene::View& v : scene.views) {
    const auto j =
        pixel_jacobian(scene, v, 0.5 * (ground.x0 + ground.x1), 0.5 * (ground.y0 + ground.y1), z);
    for (const auto& row : j) {
      const double room = std::max(S - std::abs(row[2]) * span, 0.25 * S);
      side = std::min(side, room / (std::abs(row[0]) + std::abs(row[1])));
    }
  }
  const Index columns = std::max<Index>(1, static_cast<Index>(std::ceil(ground.width() / side))),
              rows = std::max<Index>(1, static_cast<Index>(std::ceil(ground.height() / side)));
  for (Index r = 0; r < rows; ++r)
    for (Index c = 0; c < columns; ++c) {
      const double w = ground.width() / static_cast<double>(columns),
                   h = ground.height() / static_cast<double>(rows);
      const double x = ground.x0 + static_cast<double>(c) * w,
                   y = ground.y0 + static_cast<double>(r) * h;
      plan.tiles.push_back({x, y, x + w, y + h});
    }
}

/// Fills in what the program needs at most: while the network looks at the last window, while the
/// surface is rendered, or while a mesh is made of it.
void plan_memory(ReconstructPlan& plan, const nn::ModelConfig& model, const scene::Scene& scene) {
  constexpr double kProgram = 150e6;         // code, libraries and weights
  constexpr double kKept = 1.2;              // tensors, with freed ones that wait for reuse
  constexpr double kView = 4, kSurfel = 14;  // floats a pixel, floats a surfel
  constexpr double kSplat = 24, kMaps = 19;  // floats a surfel, floats a cell, to render
  constexpr double kLists = 21;              // floats a surfel, beside the tensors
  constexpr double kSeen = 9, kMesh = 110;   // floats a pixel, floats a column of voxels
  const Index views = static_cast<Index>(scene.views.size());
  const double window = static_cast<double>(plan.window) * static_cast<double>(plan.window) *
                        static_cast<double>(views);
  double pixels = 0;
  for (const scene::View& v : scene.views) pixels += static_cast<double>(v.valid.count());
  const double cells = static_cast<double>(plan.height) * static_cast<double>(plan.width);
  plan.memory = nn::forward_memory(model, views, plan.window, plan.window);
  const double network =
      nn::forward_bytes(model, views, plan.window, plan.window) +
      sizeof(float) * (kView * window + kSurfel * (pixels - std::min(pixels, window)));
  const double render = sizeof(float) * (kSplat * pixels + kMaps * cells);
  plan.memory.push_back({"surface", render});
  const double columns =
                   plan.voxel > 0 ? cells * plan.step * plan.step / (plan.voxel * plan.voxel) : 0,
               mesh = columns > 0 ? (kSurfel + kSeen) * pixels + kMesh * columns : 0;
  plan.memory_bytes =
      kProgram +
      kKept * (sizeof(float) * kView * pixels +
               std::max({network, render + sizeof(float) * kLists * pixels, sizeof(float) * mesh}));
}

/// Which surfels of a window to keep.
class Sieve {
 public:
  Sieve(const nn::NetworkInput& input, const nn::StageOutput<float>& stage)
      : input_(input),
        means_(stage.surfels.means.value()),
        heights_(stage.height.value()),
        H_(input.sources[0].rgb.dim(1)),
        W_(input.sources[0].rgb.dim(2)) {}

  /// Surfels of valid pixels whose point another view sees too and, if `tile` is given, lies in it.
  /// Where images end some heights can be compared and others cannot; a pixel whose true height
  /// is one of the latter gets a wrong one, so there another view has to agree.
  std::vector<Index> kept(const Ground* tile) const {
    const Index N = static_cast<Index>(input_.sources.size()), P = H_ * W_;
    std::vector<char> good(static_cast<std::size_t>(N * P), 0);
    for_each_index(N * H_, [&](Index row) {
      const auto i = static_cast<std::size_t>(row / H_);
      for (Index x = 0; x < W_; ++x) {
        const Index p = (row % H_) * W_ + x, k = static_cast<Index>(i) * P + p;
        const double mx = static_cast<double>(means_[3 * k]),
                     my = static_cast<double>(means_[3 * k + 1]);
        if (input_.sources[i].valid[p] <= 0) continue;
        if (tile && (mx < tile->x0 || mx >= tile->x1 || my < tile->y0 || my >= tile->y1)) continue;
        good[static_cast<std::size_t>(k)] = trusted(i, p, static_cast<double>(means_[3 * k + 2]));
      }
    });
    std::vector<Index> keep;
    for (Index k = 0; k < N * P; ++k)
      if (good[static_cast<std::size_t>(k)] != 0) keep.push_back(k);
    return keep;
  }

 private:
  bool trusted(std::size_t i, Index p, double z) const {
    bool seen = false, whole_range = false;
    for (std::size_t j = 0; j < input_.sources.size(); ++j) {
      if (j == i) continue;
      const Index there = landing(i, j, p, z);
      if (there < 0) continue;
      seen = true;
      const float other = heights_[static_cast<Index>(j) * H_ * W_ + there];
      if (std::abs(static_cast<double>(other) - z) < kAgreement) return true;
      // The path over all heights is nearly straight: both ends inside mean all of it is.
      whole_range = whole_range ||
                    (landing(i, j, p, input_.z_low) >= 0 && landing(i, j, p, input_.z_high) >= 0);
    }
    return seen && whole_range;
  }

  /// Pixel of view j nearest to where it sees pixel p of view i if that lies at height z; -1: none.
  Index landing(std::size_t i, std::size_t j, Index p, double z) const {
    const auto q =
        input_.transfer[i][j](static_cast<double>(p % W_), static_cast<double>(p / W_), z);
    const auto x = static_cast<Index>(std::lround(q[0])), y = static_cast<Index>(std::lround(q[1]));
    const bool inside =
        x >= 0 && y >= 0 && x < W_ && y < H_ && input_.sources[j].valid[y * W_ + x] > 0;
    return inside ? y * W_ + x : -1;
  }

  const nn::NetworkInput& input_;
  const Tensor &means_, &heights_;
  Index H_, W_;
};

/// Notes the larger of what there is and what one more tile took.
void keep_most(std::vector<nn::PartMemory>& most, const std::vector<nn::PartMemory>& tile) {
  if (most.empty()) most = tile;
  for (std::size_t i = 0; i < most.size(); ++i)
    most[i].bytes = std::max(most[i].bytes, tile[i].bytes);
}

/// Largest residual of all fits of a window, px. Ground distances count by the size of a pixel.
double worst_fit(const nn::NetworkInput& input, double z) {
  double worst = 0;
  for (std::size_t i = 0; i < input.sources.size(); ++i) {
    const nn::PosedImage& view = input.sources[i];
    worst = std::max({worst, view.pixel_from_local.max,
                      view.local_from_pixel.max / nn::pixel_geometry(view, z, 1).footprint});
    for (std::size_t j = 0; j < input.sources.size(); ++j)
      if (i != j) worst = std::max(worst, input.transfer[i][j].max);
  }
  return worst;
}

/// throws Error where the system has less memory than the plan needs
void check_memory(const ReconstructPlan& plan, const scene::Scene& scene) {
  const auto available = static_cast<double>(available_memory());
  // What the images take is taken already.
  const double held = static_cast<double>(tensor_bytes());
  if (plan.memory_bytes - held <= available) return;
  const auto times = [](Index a, Index b) { return std::to_string(a) + " x " + std::to_string(b); };
  throw Error("reconstruct: " + std::to_string(scene.views.size()) + " windows of " +
              times(plan.window, plan.window) + " px and a surface of " +
              times(plan.width, plan.height) + " cells need about " +
              memory_text(plan.memory_bytes) + " of memory, expected " + memory_text(available) +
              " at most; give smaller images or a coarser --resolution");
}

}  // namespace

ReconstructPlan plan_reconstruction(const nn::ModelConfig& model, const scene::Scene& scene,
                                    const ReconstructOptions& options) {
  const double z = 0.5 * (scene.z_low + scene.z_high);
  ReconstructPlan plan;
  plan.ground = common_ground(scene, z);
  const Ground& ground = plan.ground;
  plan_tiles(plan, scene, z, options.tile, nn::size_multiple(model));

  double footprint = 0;
  for (const scene::View& v : scene.views)
    footprint += rpc::view_geometry(pixel_jacobian(scene, v, 0.5 * (ground.x0 + ground.x1),
                                                   0.5 * (ground.y0 + ground.y1), z))
                     .footprint /
                 static_cast<double>(scene.views.size());
  // The grid starts at a whole multiple of its step, so that runs over one place share their cells.
  const double step = options.resolution > 0 ? options.resolution : std::round(footprint * 20) / 20;
  plan.step = step;
  if (options.mesh)
    plan.voxel =
        *options.mesh > 0 ? *options.mesh : std::max(0.05, std::round(40 * footprint) / 20);
  plan.east = std::floor((ground.x0 + scene.frame.easting0) / step) * step - scene.frame.easting0;
  plan.north = std::ceil((ground.y1 + scene.frame.northing0) / step) * step - scene.frame.northing0;
  plan.width = std::max<Index>(1, static_cast<Index>(std::ceil((ground.x1 - plan.east) / step)));
  plan.height = std::max<Index>(1, static_cast<Index>(std::ceil((plan.north - ground.y0) / step)));
  plan_memory(plan, model, scene);
  return plan;
}

Reconstruction reconstruct(const nn::Model& model, const scene::Scene& scene,
                           const ReconstructOptions& options) {
  const NoGrad no_grad;
  const auto report = [&](const std::string& stage, double fraction) {
    if (options.progress) options.progress(stage, fraction);
  };
  const double z = 0.5 * (scene.z_low + scene.z_high);
  const ReconstructPlan plan = plan_reconstruction(model.config(), scene, options);
  const Index W = plan.width, H = plan.height;
  check_memory(plan, scene);

  std::vector<Index> sources(scene.views.size());
  for (std::size_t i = 0; i < sources.size(); ++i) sources[i] = static_cast<Index>(i);
  Reconstruction out;
  std::vector<splat::Surfels> parts;
  for (std::size_t t = 0; t < plan.tiles.size(); ++t) {
    const auto poll = [&] {
      report("network", static_cast<double>(t) / static_cast<double>(plan.tiles.size()));
    };
    poll();
    const Ground& tile = plan.tiles[t];
    const scene::Crop crop = scene::make_crop(scene, sources, std::nullopt,
                                              0.5 * (tile.x0 + tile.x1), 0.5 * (tile.y0 + tile.y1),
                                              z, plan.window, scene.z_low, scene.z_high, false);
    out.camera_fit_max_px = std::max(out.camera_fit_max_px, worst_fit(crop.input, z));
    std::vector<nn::PartMemory> memory;
    const auto stages = model.forward(crop.input, poll, &memory);
    keep_most(out.memory, memory);
    poll();
    parts.push_back(splat::selected(
        stages[2].surfels,
        Sieve(crop.input, stages[2]).kept(plan.tiles.size() > 1 ? &tile : nullptr)));
  }

  out.tiles = static_cast<Index>(plan.tiles.size());
  out.voxel = plan.voxel;
  out.planned_memory_bytes = plan.memory_bytes;
  out.planned_memory = plan.memory;
  out.surfels = splat::joined(parts);
  report("surface", 0);
  const double before = static_cast<double>(tensor_bytes());
  const std::size_t earlier = peak_tensor_bytes();
  reset_peak_tensor_bytes();
  const auto render = splat::render_view(
      out.surfels, splat::nadir_camera(plan.east, plan.north, plan.step), H, W, 1);
  out.memory.push_back({"surface", static_cast<double>(peak_tensor_bytes()) - before});
  raise_peak_tensor_bytes(earlier);
  report("surface", 1);
  out.dsm = {splat::surface_heights(render), plan.east, plan.north, plan.step};
  out.confidence = Tensor({H, W}, std::nanf(""));
  Index seen = 0, expected = 0;
  for (Index i = 0; i < H * W; ++i) {
    if (std::isfinite(out.dsm.z[i])) {
      out.confidence[i] = render.aux.value()[i] / render.alpha.value()[i];
      ++seen;
      ++expected;
      continue;
    }
    const double x = plan.east + (static_cast<double>(i % W) + 0.5) * plan.step,
                 y = plan.north - (static_cast<double>(i / W) + 0.5) * plan.step;
    expected += views_seeing(scene, x, y, z) >= 2 ? 1 : 0;
  }
  out.completeness = expected > 0 ? static_cast<double>(seen) / static_cast<double>(expected) : 0;
  return out;
}

}  // namespace satsurf::reconstruct

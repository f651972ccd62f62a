// SPDX-License-Identifier: Apache-2.0
#include "satsurf/reconstruct/reconstruct.h"

#include "satsurf/core/block_pool.h"
#include "satsurf/core/memory.h"
#include "satsurf/core/parallel.h"
#include "satsurf/nn/surfel_head.h"
#include "satsurf/ops/concat.h"
#include "satsurf/reconstruct/cast.h"
#include "satsurf/reconstruct/cell_count.h"
#include "satsurf/reconstruct/fusion.h"
#include "satsurf/reconstruct/level_water.h"
#include "satsurf/reconstruct/narrow.h"
#include "satsurf/reconstruct/shown_place.h"
#include "satsurf/reconstruct/surface_input.h"
#include "satsurf/reconstruct/trust.h"
#include "satsurf/reconstruct/untextured.h"
#include "satsurf/scene/believable_span.h"
#include "satsurf/scene/crop.h"
#include "satsurf/splat/select.h"
#include "satsurf/splat/view.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <optional>
#include <string>
#include <utility>

namespace satsurf::reconstruct {
namespace {

/// Notes the larger of what there is and what one more tile took.
void keep_most(std::vector<nn::PartMemory>& most, const std::vector<nn::PartMemory>& tile) {
  if (most.empty()) most = tile;
  for (std::size_t i = 0; i < most.size(); ++i)
    most[i].bytes = std::max(most[i].bytes, tile[i].bytes);
}

/// Largest residual of all fits of a window, px. Ground distances count by the size of a pixel.
double worst_fit(const nn::NetworkInput& input) {
  double worst = 0;
  for (std::size_t i = 0; i < input.sources.size(); ++i) {
    const nn::PosedImage& view = input.sources[i];
    const double pixel = nn::pixel_geometry(view, input.z_range.middle(), 1).footprint;
    worst = std::max({worst, view.pixel_from_local.max, view.local_from_pixel.max / pixel});
    for (std::size_t j = 0; j < input.sources.size(); ++j)
      if (i != j) worst = std::max(worst, input.transfer[i][j].max);
  }
  return worst;
}

/// One window of every view.
scene::Crop window_of(const scene::Scene& scene, const ReconstructPlan& plan,
                      const std::array<double, 3>& middle) {
  std::vector<Index> sources(scene.views.size());
  std::iota(sources.begin(), sources.end(), Index{0});
  return scene::make_crop(scene, {.sources = std::move(sources),
                                  .centre = middle,
                                  .size = plan.window,
                                  .z_range = scene.z_range});
}

/// The images with their cameras, which are those of the windows where these hold whole images as
/// they lie in their files.
/// last  the window of the last tile
std::vector<nn::PosedImage> whole_images(const scene::Scene& scene, const ReconstructPlan& plan,
                                         const scene::Crop& last) {
  std::vector<nn::PosedImage> images;
  for (std::size_t i = 0; i < scene.views.size(); ++i) {
    const bool whole = plan.whole_images && scene.views[i].height() <= plan.window.height &&
                       scene.views[i].width() <= plan.window.width;
    images.push_back(
        whole && last.quarters[i] == 0
            ? scene::posed_image(scene.views[i], last.input.sources[i], last.origins[i])
            : scene::posed_image(scene.views[i], scene.frame, scene.z_range));
  }
  return images;
}

/// The confidences of surfels, which are their first auxiliary channel.
/// aux    [P K]
/// shape  of the result, of P numbers or fewer, which then are the first
Tensor first_channel(const Tensor& aux, const Shape& shape) {
  auto out = Tensor::uninitialised(shape);
  const Index K = aux.dim(1);
  for (Index i = 0; i < out.count(); ++i) out[i] = aux[i * K];
  return out;
}

/// What fusion has to know of the surfels of all tiles.
class Evidence {
 public:
  /// Adds those of a tile.
  void add(const nn::NetworkInput& input, const nn::StageOutput<float>& stage,
           const std::vector<Index>& keep) {
    const Tensor& heights = stage.height.value();
    const SurfelEvidence evidence = surfel_evidence(
        input, heights, first_channel(stage.surfels.aux.value(), heights.shape()), keep);
    weights_.push_back(Var(evidence.weight));
    compared_ += evidence.compared, agreed_ += evidence.agreed;
    rays_.push_back(Var(evidence.rays));
    interval_ += parallax_interval(input);
    const double z = input.z_range.middle();
    for (const nn::PosedImage& view : input.sources)
      footprint_ +=
          nn::pixel_geometry(view, z, 1).footprint / static_cast<double>(input.sources.size());
  }
  SurfelEvidence all() const {
    return {concat(weights_, 0).value(), concat(rays_, 0).value(), compared_, agreed_};
  }
  FusionGrid on(const Grid& cells) const {
    const double tiles = static_cast<double>(weights_.size());
    return {.east = cells.east,
            .north = cells.north,
            .step = cells.step,
            .height = cells.height,
            .width = cells.width,
            .footprint = footprint_ / tiles,
            .interval = interval_ / tiles};
  }

 private:
  std::vector<Var> weights_, rays_;
  double footprint_ = 0, interval_ = 0;  ///< summed over the tiles, m
  Index compared_ = 0, agreed_ = 0;
};

/// The cells of the surface: those that are asked for, else those of the ground that two views show
/// at the heights that were found. The plan can only guess these, and what lies higher or
/// lower is seen further out on one side.
/// means  [P 3] of all surfels
Grid cells_of(const scene::Scene& scene, const ReconstructPlan& plan,
              const ReconstructOptions& options, const Tensor& means) {
  constexpr double kWrong = 0.01;  // share of the heights on either side that is not believed
  const Index P = means.dim(0);
  if (options.grid || P == 0) return plan.grid;
  std::vector<float> z(static_cast<std::size_t>(P));
  for (Index i = 0; i < P; ++i) z[static_cast<std::size_t>(i)] = means[3 * i + 2];
  const rpc::HeightRange right = scene::span_of_all_but(kWrong, std::move(z));
  const std::array heights{right.low, right.high};
  const scene::Polygon outline = outline_of_two(scene, heights);
  return outline.empty()
             ? plan.grid
             : grid_of(scene::bounds_of(outline), scene.frame, plan.grid.step, options.cell_corner);
}

/// Splats the surfels from straight above.
FusedSurface splatted(const splat::Surfels& surfels, const Grid& cells) {
  const auto render =
      splat::render_view(surfels, splat::nadir_camera(cells.east, cells.north, cells.step),
                         cells.height, cells.width, 1);
  FusedSurface out{
      splat::surface_heights(render), Tensor({cells.height, cells.width}, std::nanf("")), {}};
  for (Index i = 0; i < out.heights.count(); ++i)
    if (std::isfinite(out.heights[i]))
      out.confidence[i] = render.aux.value()[i] / render.alpha.value()[i];
  return out;
}

/// Puts a surface on its cells and counts them.
/// unwanted  [H W] 1 where cells are not counted, or empty
void keep_surface(Reconstruction& out, FusedSurface surface, const scene::Scene& scene,
                  const Grid& cells, const Tensor& unwanted) {
  out.dsm = {std::move(surface.heights), cells.east, cells.north, cells.step};
  out.confidence = std::move(surface.confidence);
  out.completeness = count_cells(out.dsm, out.images, scene.z_range.middle(), unwanted).share();
}

/// Forgets the surface and the surfels of unwanted cells.
void leave_out(Reconstruction& out, const Tensor& unwanted, const Grid& cells) {
  for (Index i = 0; i < unwanted.count(); ++i) {
    if (!(unwanted[i] > 0)) continue;
    out.dsm.z[i] = out.confidence[i] = std::nanf("");
    if (!out.sigma.empty()) out.sigma[i] = std::nanf("");
  }
  // of surfels beyond the grid the nearest cell tells
  const auto cell = [&](double distance, Index most) {
    return std::clamp<Index>(static_cast<Index>(std::floor(distance / cells.step)), 0, most - 1);
  };
  const Tensor& means = out.surfels.means.value();
  std::vector<Index> keep;
  for (Index i = 0; i < means.dim(0); ++i) {
    const Index u = cell(static_cast<double>(means[3 * i]) - cells.east, cells.width),
                v = cell(cells.north - static_cast<double>(means[3 * i + 1]), cells.height);
    if (!(unwanted[v * cells.width + u] > 0)) keep.push_back(i);
  }
  out.surfels = splat::selected(out.surfels, keep);
}

/// The scene with the heights that are worth searching.
scene::Scene narrowed(const nn::Model& model, const scene::Scene& scene,
                      const ReconstructOptions& options) {
  scene::Scene out = scene;
  if (!options.look) return out;
  out.z_range = narrowed_range(
      model, scene,
      [&] {
        if (options.progress) options.progress("network", 0);
      },
      options.unwanted);
  return out;
}

/// Whether the first stage may ask for the look that was not taken.
bool may_look(const nn::Model& model, const scene::Scene& whole,
              const ReconstructOptions& options) {
  return options.look && !looks_first(model.config(), whole);
}

/// The surfels of all tiles, and what fusing them needs.
struct Gathered {
  splat::Surfels surfels;
  Tensor confidence;        ///< [P]
  Grid cells;               ///< of the surface
  SurfelEvidence evidence;  ///< empty, as is the grid, for a splatted surface
  FusionGrid grid;
};

/// A tile that answers also for what lies beyond the edges that it shares with the ground of all.
Ground opened(Ground tile, const Ground& all) {
  if (tile.x0 <= all.x0) tile.x0 = -INFINITY;
  if (tile.y0 <= all.y0) tile.y0 = -INFINITY;
  if (tile.x1 >= all.x1) tile.x1 = INFINITY;
  if (tile.y1 >= all.y1) tile.y1 = INFINITY;
  return tile;
}

/// Runs the network over the tiles.
/// surface   that will be made of the surfels, not automatic
/// may_look  at smaller images, if it was not before
/// out       takes what is known of the images and the work
Gathered gather(const nn::Model& model, const scene::Scene& scene, const ReconstructPlan& plan,
                Surface surface, bool may_look, const ReconstructOptions& options,
                Reconstruction& out) {
  std::vector<splat::Surfels> parts;
  Gathered all;
  Evidence evidence;
  const bool weighed = surface != Surface::splat;
  std::optional<rpc::HeightRange> looked;  // once for all tiles
  for (std::size_t t = 0; t < plan.tiles.size(); ++t) {
    const auto poll = [&] {
      if (options.progress)
        options.progress("network",
                         static_cast<double>(t) / static_cast<double>(plan.tiles.size()));
    };
    poll();
    scene::Crop crop = window_of(scene, plan, plan.middles[t]);
    out.camera_fit_max_px = std::max(out.camera_fit_max_px, worst_fit(crop.input));
    std::vector<nn::PartMemory> memory;
    rpc::HeightRange range = scene.z_range;
    const auto look = [&] {
      if (!looked) looked = looked_range(model, scene, poll, options.unwanted);
      return *looked;
    };
    const auto stages = model.forward(
        crop.input, poll, &memory, wanted_of(surface), [&](const nn::StageHeights<float>& first) {
          const auto left =
              range_left(model.config(), scene, crop.input, first,
                         may_look ? look : std::function<rpc::HeightRange()>(), options.unwanted);
          range = left.value_or(range);
          return left;
        });
    crop.input.z_range = range;
    out.z_range = t == 0 ? range : hull(out.z_range, range);
    keep_most(out.memory, memory);
    poll();
    const auto tile =
        plan.tiles.size() > 1 ? std::optional(opened(plan.tiles[t], plan.ground)) : std::nullopt;
    const splat::Surfels& surfels = stages[2].surfels;
    const std::vector<Index> keep =
        trusted_surfels(crop.input, surfels.means.value(), stages[2].height.value(), tile);
    parts.push_back(splat::selected(surfels, keep));
    if (weighed) evidence.add(crop.input, stages[2], keep);
    if (t + 1 == plan.tiles.size()) out.images = whole_images(scene, plan, crop);
  }
  out.frame = scene.frame;
  out.tiles = static_cast<Index>(plan.tiles.size());
  out.voxel = plan.voxel;
  out.planned_memory_bytes = plan.memory_bytes;
  out.planned_mesh_bytes = plan.mesh_bytes;
  out.planned_memory = plan.memory;
  all.surfels = splat::joined(parts);
  all.cells = cells_of(scene, plan, options, all.surfels.means.value());
  if (weighed) all.evidence = evidence.all(), all.grid = evidence.on(all.cells);
  out.compared = all.evidence.compared, out.agreed = all.evidence.agreed;
  all.confidence = first_channel(all.surfels.aux.value(), {all.surfels.means.value().dim(0)});
  return all;
}

nn::SurfaceInput input_of(const Gathered& all, const Reconstruction& made) {
  return surface_input(all.surfels.means.value(), all.confidence, all.evidence, all.grid,
                       made.images);
}

/// Logarithms of the cells' colours above black, [3 H W].
Tensor log_colours(const nn::SurfaceInput& input, const std::vector<nn::PosedImage>& images) {
  constexpr float kDarkest = 1e-3f;  // of an image's standard deviation
  double black = 0;
  for (const nn::PosedImage& image : images)
    black += nn::standardised_black(image) / static_cast<double>(images.size());
  const Index H = input.planes.dim(1), W = input.planes.dim(2);
  auto out = Tensor::uninitialised({3, H, W});
  const float* colours = input.planes.data() + static_cast<Index>(nn::SurfacePlane::red) * H * W;
  for_range(out.count(), 1 << 14, [&](Index begin, Index end) {
    for (Index i = begin; i < end; ++i)
      out[i] = std::log(std::max(colours[i] - static_cast<float>(black), kDarkest));
  });
  return out;
}

/// The surface as the network makes it, where two images or more show it. Its confidence is that of the
/// surfels times the share of them that agree, 0 in the holes that the network filled: what it guessed
/// there, and where fewer than two images show the densest mode, is kept if they show it lower, too.
/// made  its images are whole; gets the expected errors, and what became level and even
FusedSurface refined(const ReconstructOptions& options, const Gathered& all, Reconstruction& made) {
  const nn::SurfaceInput input = input_of(all, made);
  nn::RefinedSurface surface = nn::refined(*options.network, input);
  FusedSurface out{std::move(surface.heights), Tensor::uninitialised(surface.sigma.shape()), {}};
  made.sigma = std::move(surface.sigma);
  const Index P = made.sigma.count();
  const auto plane = [&](nn::SurfacePlane p) {
    return input.planes.data() + static_cast<Index>(p) * P;
  };
  const float *sure = plane(nn::SurfacePlane::confidence),
              *share = plane(nn::SurfacePlane::mode_share), *views = plane(nn::SurfacePlane::views);
  const Grid& cells = all.cells;
  for_each_index(cells.height, [&](Index row) {
    const double y = cells.north - (static_cast<double>(row) + 0.5) * cells.step;
    for (Index i = row * cells.width; i < (row + 1) * cells.width; ++i) {
      const double x = cells.east + (static_cast<double>(i % cells.width) + 0.5) * cells.step;
      out.confidence[i] = sure[i] * share[i];
      const bool guessed = views[i] < nn::kViewsOfTwo || !(out.confidence[i] > 0);
      if (guessed && !shown_by_two_if_lower(made.images, x, y, static_cast<double>(out.heights[i]),
                                            static_cast<double>(surface.doubt[i])))
        out.heights[i] = out.confidence[i] = made.sigma[i] = surface.doubt[i] = std::nanf("");
    }
  });
  // first, so that a roof in doubt stands above the street again before that is taken for its shore
  if (options.even_untextured)
    made.evened =
        even_untextured(out.heights, made.sigma, log_colours(input, made.images), cells.step);
  if (options.level_water)
    made.levelled = level_water(out.heights, made.sigma, surface.doubt, out.confidence, cells.step);
  return out;
}

}  // namespace

ReconstructPlan plan_of_run(const nn::Model& model, const scene::Scene& scene,
                            const ReconstructOptions& options) {
  const NoGrad no_grad;
  return plan_reconstruction(model.config(), narrowed(model, scene, options), options);
}

Reconstruction reconstruct(const nn::Model& model, const scene::Scene& whole,
                           const ReconstructOptions& options) {
  const NoGrad no_grad;
  const scene::Scene scene = narrowed(model, whole, options);
  const ReconstructPlan plan = plan_reconstruction(model.config(), scene, options);
  check_memory(plan, scene);
  Reconstruction out;
  Gathered all = gather(model, scene, plan, surface_kind(options), may_look(model, whole, options),
                        options, out);
  const auto report = [&](double fraction) {
    if (options.progress) options.progress("surface", fraction);
  };
  report(0);
  const double before = static_cast<double>(tensor_bytes());
  const std::size_t earlier = peak_tensor_bytes();
  reset_peak_tensor_bytes();
  FusedSurface surface;
  switch (surface_kind(options)) {
    case Surface::refined:
      surface = refined(options, all, out);
      break;
    case Surface::plain:
      surface = fuse_surfels(all.surfels.means.value(), all.confidence, all.evidence, all.grid);
      all.surfels = splat::selected(all.surfels, surface.kept);
      break;
    default:
      surface = splatted(all.surfels, all.cells);
  }
  out.surfels = std::move(all.surfels);
  out.memory.push_back({"surface", static_cast<double>(peak_tensor_bytes()) - before});
  raise_peak_tensor_bytes(earlier);
  report(1);
  const Tensor unwanted = options.unwanted ? options.unwanted(all.cells) : Tensor();
  keep_surface(out, std::move(surface), scene, all.cells, unwanted);
  if (!out.sigma.empty()) out.surfels = cast_on(out.surfels, all.evidence.rays, out.dsm);
  // last, so that a ray that ends on such ground is not cast beyond it
  if (!unwanted.empty()) leave_out(out, unwanted, all.cells);
  return out;
}

UnrefinedSurface unrefined_surface(const nn::Model& model, const scene::Scene& whole,
                                   const ReconstructOptions& options) {
  const NoGrad no_grad;
  const scene::Scene scene = narrowed(model, whole, options);
  ReconstructOptions how = options;
  how.surface = Surface::plain;
  const ReconstructPlan plan = plan_reconstruction(model.config(), scene, how);
  check_memory(plan, scene);
  Reconstruction made;
  const Gathered all =
      gather(model, scene, plan, Surface::refined, may_look(model, whole, options), how, made);
  return {input_of(all, made), all.cells.east, all.cells.north, all.cells.step};
}

}  // namespace satsurf::reconstruct

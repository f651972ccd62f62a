// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/beside.h"
#include "satsurf/app/interrupt.h"
#include "satsurf/app/legend.h"
#include "satsurf/app/preview.h"
#include "satsurf/app/products.h"
#include "satsurf/app/reconstruct_job.h"
#include "satsurf/app/reconstruct_report.h"
#include "satsurf/app/surface_files.h"
#include "satsurf/core/block_pool.h"
#include "satsurf/core/memory.h"
#include "satsurf/core/parallel.h"
#include "satsurf/mesh/ply.h"
#include "satsurf/mesh/surface.h"
#include "satsurf/reconstruct/rendered_view.h"
#include "satsurf/scene/pointing_file.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <functional>
#include <future>
#include <string>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

namespace satsurf::app {
namespace {

namespace fs = std::filesystem;

double mean_of(const Tensor& t) {
  double sum = 0, n = 0;
  for (const float v : t.values())
    if (std::isfinite(v)) sum += static_cast<double>(v), n += 1;
  return sum / n;
}

void print_plan(const reconstruct::ReconstructPlan& plan, const scene::UserScene& user,
                const ReconstructJob& job) {
  print_plan_ground(user, plan.z_range, plan.ground, job.crs);
  std::printf("surface       about %td x %td cells of %g m\n", plan.grid.width, plan.grid.height,
              plan.grid.step);
  if (plan.voxel > 0) std::printf("mesh          voxels of %g m\n", plan.voxel);
  std::printf("tiles         %zu, each with %zu windows of %td x %td px\n", plan.tiles.size(),
              user.scene.views.size(), plan.window.height, plan.window.width);
  std::printf("memory        about %s; %s are free\n", memory_text(plan.memory_bytes).c_str(),
              memory_text(static_cast<double>(available_memory())).c_str());
  for (const nn::PartMemory& part : plan.memory)
    std::printf("  %-12s%s\n", part.part.c_str(), memory_text(part.bytes).c_str());
  if (plan.mesh_bytes > std::min(plan.memory_bytes, static_cast<double>(available_memory())))
    std::printf("  mesh        %s, which it would not get: give a larger --voxel or --mesh none\n",
                memory_text(plan.mesh_bytes).c_str());
  print_plan_time({.megapixels = plan.megapixels,
                   .views = static_cast<Index>(user.scene.views.size()),
                   .cells = plan.grid.cells(),
                   .columns = plan.columns,
                   .so_far = job.record.seconds()});
}

/// [{part, bytes, planned_bytes}], and the same for the log.
nlohmann::ordered_json memory_by_part(const reconstruct::Reconstruction& made) {
  auto list = nlohmann::ordered_json::array();
  for (std::size_t i = 0; i < made.memory.size(); ++i) {
    const nn::PartMemory &part = made.memory[i], &planned = made.planned_memory[i];
    list.push_back({{"part", part.part}, {"bytes", part.bytes}, {"planned_bytes", planned.bytes}});
    log_line(LogLevel::debug, "memory: " + part.part + " took " + memory_text(part.bytes) +
                                  ", foreseen were " + memory_text(planned.bytes));
  }
  return list;
}

/// The surface as the cameras of the images see it.
struct RenderedViews {
  std::vector<Tensor> colours;             ///< [3 H W]
  std::vector<mesh::HeightImage> heights;  ///< with the colours of the images; empty unless wanted
};

RenderedViews render_views(const reconstruct::Reconstruction& made, bool heights,
                           Progress& progress) {
  RenderedViews out;
  for (std::size_t i = 0; i < made.images.size(); ++i) {
    progress.update("render", static_cast<double>(i) / static_cast<double>(made.images.size()));
    stop_if_interrupted();
    reconstruct::RenderedView view = reconstruct::rendered_view(made.surfels, made.images[i]);
    out.colours.push_back(std::move(view.colour));
    if (heights) out.heights.push_back(std::move(view.heights));
  }
  progress.update("render", 1);
  return out;
}

void write_pictures(const OutputFolder& folder, const reconstruct::Reconstruction& made,
                    const scene::Scene& scene, const RenderedViews& rendered) {
  fs::create_directories(folder / "views");
  using Writer = std::function<void(const fs::path&)>;
  const rpc::GeoGrid grid = geo_grid(made.dsm, made.frame);
  const ColourScale heights = height_scale(made.dsm.z, made.frame.h0), sure = confidence_scale();
  const auto map = [&](const std::function<Tensor()>& picture, const ColourScale* scale) -> Writer {
    return [&grid, picture, scale](const fs::path& to) { write_map(to, picture(), scale, grid); };
  };
  std::vector<std::pair<std::string, Writer>> pictures{
      {"height.png", map([&] { return height_picture(made.dsm.z); }, &heights)},
      {"hillshade.png", map([&] { return hillshade_picture(made.dsm.z, made.dsm.step); }, nullptr)},
      {"confidence.png", map([&] { return confidence_picture(made.confidence); }, &sure)}};
  for (std::size_t i = 0; i < scene.views.size(); ++i) {
    const scene::View& view = scene.views[i];
    pictures.push_back({"views/" + view.name + "_render.png", [&rendered, i](const fs::path& to) {
                          write_png(to, rendered.colours[i]);
                        }});
    pictures.push_back({"views/" + view.name + "_source.png",
                        [&view](const fs::path& to) { write_png(to, view.rgb); }});
  }
  // Compression takes as long as rendering, and one picture knows nothing of the other.
  for_each_index(static_cast<Index>(pictures.size()), [&](Index i) {
    stop_if_interrupted();
    const auto& [name, write] = pictures[static_cast<std::size_t>(i)];
    write(folder / name);
  });
}

/// Fuses what the views see into a mesh, writes it and says what it is.
nlohmann::ordered_json write_mesh(const fs::path& file, const std::vector<mesh::HeightImage>& seen,
                                  const reconstruct::Reconstruction& made,
                                  const rpc::LocalFrame& frame) {
  const auto start = std::chrono::steady_clock::now();
  mesh::FusionOptions how;
  how.voxel = made.voxel;
  mesh::Mesh surface;
  release_tensor_cache();  // voxels are no tensors
  try {
    if (made.planned_mesh_bytes > made.planned_memory_bytes)
      throw Error(
          fmt::format("voxels of {:g} m need {}, more than --max-memory; give a larger "
                      "--voxel",
                      how.voxel, memory_text(made.planned_mesh_bytes)));
    check_memory(fmt::format("voxels of {:g} m need", how.voxel), made.planned_mesh_bytes,
                 "give a larger --voxel", static_cast<double>(tensor_bytes()));
    surface = mesh::mesh_from_views(seen, how);
  } catch (const Error& e) {
    throw Error(std::string(e.what()) + "; --mesh none leaves it out");
  }
  const double seconds =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  mesh::write_ply(file, surface, frame_comments(frame));
  return {{"voxel", how.voxel},
          {"vertices", surface.vertices.size()},
          {"faces", surface.faces.size()},
          {"seconds", seconds}};
}

/// Lowest and highest cell of the surface, m above the ellipsoid.
/// throws Error if no cell got a height
rpc::HeightRange heights_found(const reconstruct::Reconstruction& made, double h0,
                               const std::vector<fs::path>& images) {
  std::vector<float> known;
  for (const float v : made.dsm.z.values())
    if (std::isfinite(v)) known.push_back(v);
  if (known.empty()) refuse_no_heights(images);
  const auto [low, high] = std::minmax_element(known.begin(), known.end());
  return {*low + h0, *high + h0};
}

SurfaceFacts facts_of(const reconstruct::Reconstruction& made) {
  SurfaceFacts facts;
  facts.completeness = made.completeness, facts.resolution = made.dsm.step;
  facts.mean_confidence = mean_of(made.confidence);
  facts.camera_fit_max_px = made.camera_fit_max_px;
  facts.rows = made.dsm.z.dim(0), facts.columns = made.dsm.z.dim(1);
  facts.surfels = made.surfels.means.dim(0), facts.tiles = made.tiles;
  facts.compared = made.compared, facts.agreed = made.agreed, facts.levelled = made.levelled;
  facts.evened = made.evened;
  facts.searched = made.frame.heights_from_z(made.z_range);
  facts.planned_memory_bytes = made.planned_memory_bytes;
  return facts;
}

/// Whether the surface alone would take more than it may, as one of fine cells does.
bool exceeds_limit(const ReconstructJob& job, const scene::Scene& scene,
                   const reconstruct::ReconstructOptions& how) {
  return how.max_memory > 0 &&
         reconstruct::plan_reconstruction(job.networks.model.config(), scene, how).surface_bytes >
             how.max_memory;
}

}  // namespace

bool reconstruct_whole(ReconstructJob& job) {
  const ReconstructCommand& options = job.options;
  Progress& progress = job.progress;
  progress.update("read", 0);
  const scene::UserScene user = scene::scene_from_views(
      options.images, options.image_dirs, job.height_range, stop_if_interrupted, job.rules);
  stop_if_interrupted();
  const scene::Scene& scene = user.scene;
  reconstruct::ReconstructOptions how = job.how(scene.frame);
  const bool with_mesh = options.mesh == MeshKind::tsdf;
  if (with_mesh) how.mesh = options.voxel;
  if (exceeds_limit(job, scene, how)) return false;
  job.settle_crs(user);
  job.note_scene(user);

  const auto start = std::chrono::steady_clock::now();
  how.progress = [&](const std::string& stage, double fraction) {
    stop_if_interrupted();
    progress.update(stage, fraction);
  };
  if (options.dry_run) {
    print_plan(reconstruct::plan_of_run(job.networks.model, scene, how), user, job);
    return true;
  }
  OutputFolder& folder = *job.staged;
  const reconstruct::Reconstruction made = reconstruct::reconstruct(job.networks.model, scene, how);
  SurfaceFacts facts = facts_of(made);
  facts.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  facts.datum = datum_of(options.geoid);
  facts.crs = "EPSG:" + std::to_string(scene.frame.zone.epsg());
  facts.heights = heights_found(made, scene.frame.h0, options.images);
  job.warnings.add(reconstruct::surface_warnings(made));
  const auto agreement = reconstruct::image_agreement(made.dsm, made.images);
  facts.image_correlation = agreement.correlation;
  job.warnings.add(reconstruct::image_warnings(agreement, scene.views));

  progress.update("write", 0);
  const reconstruct::Visibility visibility = reconstruct::find_visibility(
      made.dsm, made.images, reconstruct::exposures_of(made.images, made.z_range.middle()));
  std::future<void> surfels =
      write_surfels(folder / "surfels.ply", made, scene.frame, options.max_surfels);
  write_rasters(folder.path(), made, scene, visibility, facts.datum);
  if (user.pointing) scene::write_pointing(folder / "pointing.json", *user.pointing);
  stop_if_interrupted();
  job.warnings.attempt("orthophoto", [&] {
    write_ortho(folder / "ortho.tif", made, scene, visibility, options.image_dirs);
  });
  stop_if_interrupted();
  if (job.crs) job.bring_rasters(geo_grid(made.dsm, scene.frame), facts);
  RenderedViews rendered;
  std::future<void> pictures;  // beside the mesh, of which parts are not parallel
  job.warnings.attempt("pictures", [&] {
    rendered = render_views(made, with_mesh, progress);
    pictures = beside([&] { write_pictures(folder, made, scene, rendered); });
  });
  stop_if_interrupted();
  if (with_mesh) {
    progress.update("mesh", 0);
    job.warnings.attempt("mesh", [&] {
      facts.mesh = write_mesh(folder / "mesh.ply", rendered.heights, made, scene.frame);
    });
    progress.update("mesh", 1);
    stop_if_interrupted();
  }
  progress.update("pictures", 0);
  if (pictures.valid()) job.warnings.attempt("pictures", [&] { pictures.get(); });
  progress.update("pictures", 1);
  stop_if_interrupted();
  surfels.get();
  job.record.results() = results_json(facts, user);
  job.record.results()["memory_by_part"] = memory_by_part(made);
  if (options.report == ReportKind::html)
    job.warnings.attempt("report", [&] {
      write_report(folder / "report.html", report_of({made, user, &visibility}, job.record));
    });
  job.record.save(folder / "run.json");
  folder.commit();
  print_summary(facts, scene, job.record.seconds(), options.out);
  check_coverage(made.completeness, options);
  return true;
}

}  // namespace satsurf::app

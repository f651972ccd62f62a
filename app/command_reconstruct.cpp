// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/interrupt.h"
#include "satsurf/app/log.h"
#include "satsurf/app/output_folder.h"
#include "satsurf/app/pointing_text.h"
#include "satsurf/app/preview.h"
#include "satsurf/app/products.h"
#include "satsurf/app/program.h"
#include "satsurf/app/progress.h"
#include "satsurf/app/reconstruct_options.h"
#include "satsurf/app/record.h"
#include "satsurf/app/surface_files.h"
#include "satsurf/core/error.h"
#include "satsurf/core/memory.h"
#include "satsurf/core/parallel.h"
#include "satsurf/core/var.h"
#include "satsurf/mesh/ply.h"
#include "satsurf/mesh/surface.h"
#include "satsurf/nn/shipped_weights.h"
#include "satsurf/nn/weights_file.h"
#include "satsurf/reconstruct/reconstruct.h"
#include "satsurf/reconstruct/rendered_view.h"
#include "satsurf/reconstruct/warnings.h"
#include "satsurf/scene/pointing_file.h"
#include "satsurf/scene/user_images.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <functional>
#include <memory>
#include <new>
#include <optional>
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

/// The heights to search, if any were asked for.
/// throws  ConfigError for a range that holds no surface
std::optional<rpc::HeightRange> range_of(const ReconstructConfig& config) {
  if (!config.height_range) return std::nullopt;
  const rpc::HeightRange range{(*config.height_range)[0], (*config.height_range)[1]};
  scene::check_height_range(range);
  return range;
}

/// What was asked for, for the record.
nlohmann::json config_json(ReconstructConfig config, const fs::path& weights) {
  config.weights = weights;
  return to_json(config);
}

void note_range(const scene::RangeChoice& choice, Progress& progress) {
  progress.note(fmt::format("height range {:.1f} to {:.1f} m above the ellipsoid, {}",
                            choice.height_range.low, choice.height_range.high, choice.source));
}

/// What to do about cameras that disagree.
/// throws  IoError for a file that is none of shifts
scene::PointingChoice pointing_of(const ReconstructConfig& config) {
  if (config.pointing == "shift") return {};
  if (config.pointing == "off") return {.measure = false};
  return {.given = scene::read_pointing(config.pointing)};
}

/// Says how the cameras agree and what was done about it; warns where nothing could be measured, and
/// where shifted cameras see the ground outside the range that was asked for.
void note_pointing(const scene::UserScene& user, Progress& progress) {
  if (!user.pointing) return;
  const scene::Pointing& pointing = *user.pointing;
  const bool refused = pointing.after.empty();
  progress.note(pointing_line(pointing) + (refused ? "; the cameras stay as they are" : ""),
                refused ? LogLevel::warning : LogLevel::info);
  const rpc::HeightRange& range = user.range.height_range;
  if (pointing.applied && pointing.heights &&
      (pointing.heights->low < range.low || pointing.heights->high > range.high))
    progress.note(fmt::format("shifted cameras see ground from {:.0f} to {:.0f} m, expected it "
                              "within the height range",
                              pointing.heights->low, pointing.heights->high),
                  LogLevel::warning);
}

/// Says which images have a border that nobody had declared.
void note_borders(const scene::Scene& scene, Progress& progress) {
  for (const scene::View& view : scene.views)
    if (view.border > 0)
      progress.note(fmt::format("{}: a border of one value, {:.1f} % of the image, is left out",
                                view.label(), 100 * view.border));
}

/// Tells warnings and keeps them for the record.
class Warnings {
 public:
  Warnings(Progress& progress, RunRecord& record) : progress_(progress), record_(record) {}

  void add(const reconstruct::Warning& warning) {
    progress_.note(warning.text, LogLevel::warning);
    record_.add_warning(warning.code, warning.text);
  }
  void add(const std::vector<reconstruct::Warning>& warnings) {
    for (const reconstruct::Warning& warning : warnings) add(warning);
  }
  /// Does a part of the work that the surface can do without: its failure is a warning.
  /// what  of the results it makes; `what` and _failed is the code
  template <class F>
  void attempt(const std::string& what, F&& work) {
    try {
      work();
    } catch (const Error& e) {
      add({what + "_failed", "no " + what + ": " + e.what()});
    } catch (const std::bad_alloc&) {
      add({what + "_failed", "no " + what + ": out of memory; try smaller images"});
    }
  }

 private:
  Progress& progress_;
  RunRecord& record_;
};

void print_plan(const reconstruct::ReconstructPlan& plan, const scene::UserScene& user) {
  const rpc::LocalFrame& frame = user.scene.frame;
  std::printf("height range  %.1f to %.1f m above the ellipsoid, %s\n", user.range.height_range.low,
              user.range.height_range.high, user.range.source.c_str());
  std::printf("ground        EPSG:%d, east %.0f to %.0f, north %.0f to %.0f (%.0f m x %.0f m)\n",
              frame.zone.epsg(), plan.ground.x0 + frame.easting0, plan.ground.x1 + frame.easting0,
              plan.ground.y0 + frame.northing0, plan.ground.y1 + frame.northing0,
              plan.ground.width(), plan.ground.height());
  std::printf("surface       %td x %td cells of %g m\n", plan.width, plan.height, plan.step);
  if (plan.voxel > 0) std::printf("mesh          voxels of %g m\n", plan.voxel);
  std::printf("tiles         %zu, each with %zu windows of %td x %td px\n", plan.tiles.size(),
              user.scene.views.size(), plan.window, plan.window);
  std::printf("memory        about %s; %s are free\n", memory_text(plan.memory_bytes).c_str(),
              memory_text(static_cast<double>(available_memory())).c_str());
  for (const nn::PartMemory& part : plan.memory)
    std::printf("  %-12s%s\n", part.part.c_str(), memory_text(part.bytes).c_str());
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
    if (interrupted()) throw Interrupted{};
    reconstruct::RenderedView view = reconstruct::rendered_view(made.surfels, made.images[i]);
    out.colours.push_back(std::move(view.colour));
    if (heights) out.heights.push_back(std::move(view.heights));
  }
  progress.update("render", 1);
  return out;
}

void write_pictures(const OutputFolder& folder, const reconstruct::Reconstruction& made,
                    const scene::Scene& scene, const RenderedViews& rendered, Progress& progress) {
  fs::create_directories(folder / "views");
  std::vector<std::pair<std::string, std::function<Tensor()>>> pictures{
      {"height.png", [&] { return height_picture(made.dsm.z); }},
      {"hillshade.png", [&] { return hillshade_picture(made.dsm.z, made.dsm.step); }},
      {"confidence.png", [&] { return confidence_picture(made.confidence); }}};
  progress.update("pictures", 0);
  for (std::size_t i = 0; i < scene.views.size(); ++i) {
    const scene::View& view = scene.views[i];
    pictures.push_back(
        {"views/" + view.name + "_render.png", [colour = rendered.colours[i]] { return colour; }});
    pictures.push_back({"views/" + view.name + "_source.png", [&view] { return view.rgb; }});
  }
  // Compression takes as long as rendering, and one picture knows nothing of the other.
  for_each_index(static_cast<Index>(pictures.size()), [&](Index i) {
    if (interrupted()) throw Interrupted{};
    const auto& [name, picture] = pictures[static_cast<std::size_t>(i)];
    write_png(folder / name, picture());
  });
  progress.update("pictures", 1);
}

/// Fuses what the views see into a mesh, writes it and says what it is.
nlohmann::ordered_json write_mesh(const fs::path& file, const std::vector<mesh::HeightImage>& seen,
                                  const reconstruct::Reconstruction& made,
                                  const rpc::LocalFrame& frame) {
  const auto start = std::chrono::steady_clock::now();
  mesh::FusionOptions how;
  how.voxel = made.voxel;
  mesh::Mesh surface;
  try {
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
  if (known.empty()) {
    std::string names;
    for (const fs::path& file : images) names += (names.empty() ? "" : ", ") + file.string();
    throw Error("no cell of the surface got a height from " + names +
                ", expected images that agree; see satsurf info");
  }
  const auto [low, high] = std::minmax_element(known.begin(), known.end());
  return {*low + h0, *high + h0};
}

/// What is said of a surface besides itself.
struct Summary {
  rpc::HeightRange heights;     ///< lowest and highest cell, m above the ellipsoid
  nlohmann::ordered_json mesh;  ///< see `write_mesh`; null without one
  double seconds = 0;           ///< that making the surface took
  double wall_seconds = 0;      ///< that all took
};

/// What became of the images.
nlohmann::json images_json(const scene::Scene& scene) {
  auto list = nlohmann::json::array();
  for (const scene::View& view : scene.views) {
    const auto& [channels, low, high] = view.colours;
    list.push_back({{"name", view.name},
                    {"bands", view.bands},
                    {"type", view.dtype},
                    {"rgb_bands", {channels[0] + 1, channels[1] + 1, channels[2] + 1}},
                    {"stretch", {low, high}},
                    {"border", view.border}});
  }
  return list;
}

/// The results in the record of the run.
nlohmann::json results_json(const reconstruct::Reconstruction& made, const scene::UserScene& user,
                            const Summary& summary) {
  return {{"completeness", made.completeness},
          {"cells", {made.dsm.z.dim(0), made.dsm.z.dim(1)}},
          {"resolution", made.dsm.step},
          {"crs", "EPSG:" + std::to_string(user.scene.frame.zone.epsg())},
          {"vertical_datum", "WGS84 ellipsoid"},
          {"height_range", {user.range.height_range.low, user.range.height_range.high}},
          {"height_range_source", user.range.source},
          {"height_range_searched",
           {made.z_range.low + made.frame.h0, made.z_range.high + made.frame.h0}},
          {"pointing", user.pointing ? pointing_json(*user.pointing) : nlohmann::ordered_json()},
          {"lowest", summary.heights.low},
          {"highest", summary.heights.high},
          {"mean_confidence", mean_of(made.confidence)},
          {"surfels", made.surfels.means.dim(0)},
          {"tiles", made.tiles},
          {"images", images_json(user.scene)},
          {"camera_fit_max_px", made.camera_fit_max_px},
          {"planned_memory_bytes", made.planned_memory_bytes},
          {"memory_by_part", memory_by_part(made)},
          {"mesh", summary.mesh},
          {"reconstruct_seconds", summary.seconds}};
}

void print_summary(const reconstruct::Reconstruction& made, const scene::Scene& scene,
                   const Summary& summary, const fs::path& out) {
  std::printf(
      "surface       %td x %td cells of %g m, EPSG:%d, %.1f to %.1f m above the ellipsoid\n",
      made.dsm.z.dim(1), made.dsm.z.dim(0), made.dsm.step, scene.frame.zone.epsg(),
      summary.heights.low, summary.heights.high);
  std::printf("completeness  %.1f %%\n", 100 * made.completeness);
  std::printf("confidence    %.3f on average\n", mean_of(made.confidence));
  std::printf("surfels       %td from %zu images in %td tile%s\n", made.surfels.means.dim(0),
              scene.views.size(), made.tiles, made.tiles == 1 ? "" : "s");
  if (!summary.mesh.is_null())
    std::printf("mesh          %td faces, voxels of %g m\n", summary.mesh["faces"].get<Index>(),
                summary.mesh["voxel"].get<double>());
  std::printf("time          %.1f s, %.1f s of them for the surface\n", summary.wall_seconds,
              summary.seconds);
  std::printf("written to    %s\n", out.c_str());
}

/// throws  Error for a surface with fewer cells than were asked for
void check_coverage(double completeness, const ReconstructCommand& options) {
  if (completeness >= options.min_coverage) return;
  throw Error(
      fmt::format("{:.1f} % of the common ground has a height, expected {:.1f} % by "
                  "--min-coverage; the surface is in {}",
                  100 * completeness, 100 * options.min_coverage, options.out.string()));
}

void run_reconstruct(const ReconstructCommand& options) {
  const std::optional<rpc::HeightRange> height_range = range_of(options);
  const NoGrad no_grad;
  const fs::path weights =
      options.weights.empty()
          ? nn::shipped_weights(nn::ShippedNetwork::cascade, "give --weights FILE")
          : options.weights;
  std::vector<fs::path> apart{weights};
  apart.insert(apart.end(), options.images.begin(), options.images.end());
  apart.insert(apart.end(), options.image_dirs.begin(), options.image_dirs.end());
  apart.push_back(options.config_file);
  const scene::PointingChoice pointing = pointing_of(options);
  if (pointing.given) apart.push_back(options.pointing);
  std::optional<OutputFolder> staged;
  if (!options.dry_run)
    staged.emplace(OutputFolder::staged(options.out, options.overwrite, std::move(apart)));
  RunRecord record("reconstruct", config_json(options, weights), 0);
  const nn::Model model = nn::load_model(weights);
  const std::optional<nn::SurfaceModel> network = nn::load_surface(weights);

  Progress progress;
  progress.update("read", 0);
  const auto poll = [] {
    if (interrupted()) throw Interrupted{};
  };
  scene::ViewRules rules;
  rules.validity.nodata = options.nodata;
  rules.pointing = pointing;
  const scene::UserScene user =
      scene::scene_from_views(options.images, options.image_dirs, height_range, poll, rules);
  poll();
  const scene::Scene& scene = user.scene;
  note_pointing(user, progress);
  note_range(user.range, progress);
  note_borders(scene, progress);
  Warnings warnings(progress, record);
  warnings.add(reconstruct::scene_warnings(scene));
  if (staged) {
    std::vector<fs::path> inputs{weights};
    if (pointing.given) inputs.push_back(options.pointing);
    for (const scene::View& view : scene.views)
      inputs.insert(inputs.end(), view.files.begin(), view.files.end());
    staged->add_inputs(inputs);
    for (const fs::path& file : inputs) record.add_input(file);
  }

  const auto start = std::chrono::steady_clock::now();
  reconstruct::ReconstructOptions how;
  how.surface = options.surface;
  how.network = network ? &*network : nullptr;
  how.resolution = options.resolution;
  const bool with_mesh = options.mesh == MeshKind::tsdf;
  if (with_mesh) how.mesh = options.voxel;
  how.progress = [&](const std::string& stage, double fraction) {
    poll();
    progress.update(stage, fraction);
  };
  if (options.dry_run)
    return print_plan(reconstruct::plan_reconstruction(model.config(), scene, how), user);
  OutputFolder& folder = *staged;
  const reconstruct::Reconstruction made = reconstruct::reconstruct(model, scene, how);
  Summary summary;
  summary.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  summary.heights = heights_found(made, scene.frame.h0, options.images);
  warnings.add(reconstruct::surface_warnings(made, scene));

  progress.update("write", 0);
  const reconstruct::Visibility visibility = reconstruct::find_visibility(made.dsm, made.images);
  write_surface(folder.path(), made, scene, visibility, options.max_surfels);
  if (user.pointing) scene::write_pointing(folder / "pointing.json", *user.pointing);
  poll();
  warnings.attempt("orthophoto", [&] {
    write_ortho(folder / "ortho.tif", made, scene, visibility, options.image_dirs);
  });
  poll();
  std::vector<mesh::HeightImage> seen;
  warnings.attempt("pictures", [&] {
    RenderedViews rendered = render_views(made, with_mesh, progress);
    seen = std::move(rendered.heights);
    write_pictures(folder, made, scene, rendered, progress);
  });
  poll();
  if (with_mesh) {
    progress.update("mesh", 0);
    warnings.attempt(
        "mesh", [&] { summary.mesh = write_mesh(folder / "mesh.ply", seen, made, scene.frame); });
    progress.update("mesh", 1);
    poll();
  }
  record.results() = results_json(made, user, summary);
  record.save(folder / "run.json");
  folder.commit();
  summary.wall_seconds = record.seconds();
  print_summary(made, scene, summary, options.out);
  check_coverage(made.completeness, options);
}

}  // namespace

void add_reconstruct(Program& program) {
  Command& command = program.add("reconstruct", "the surface two or more images show");
  command.files = written_by_reconstruct();
  command.results = told_by_reconstruct();
  const auto options = std::make_shared<ReconstructCommand>();
  ReconstructConfig& config = *options;
  Flags& flags = command.flags;
  flags.add(collect_fields(*options));
  flags.add_config();
  flags.add(collect_fields(config), "Configuration");
  program.when_called(command, [&flags, options]() -> std::function<void()> {
    ReconstructConfig& asked = *options;
    flags.read(collect_fields(*options));
    options->config_file = flags.config_file();
    read_config(flags, asked);
    if (flags.print_config())
      return [options] { print_config(static_cast<const ReconstructConfig&>(*options)); };
    if (options->images.empty()) throw CLI::RequiredError("images");
    if (!options->dry_run) Flags::require("--out", options->out);
    return [options] { run_reconstruct(*options); };
  });
}

}  // namespace satsurf::app

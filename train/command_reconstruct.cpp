// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/memory.h"
#include "satsurf/core/parallel.h"
#include "satsurf/core/var.h"
#include "satsurf/mesh/ply.h"
#include "satsurf/mesh/surface.h"
#include "satsurf/rpc/raster.h"
#include "satsurf/rpc/read.h"
#include "satsurf/splat/ply.h"
#include "satsurf/train/commands.h"
#include "satsurf/train/log.h"
#include "satsurf/train/output_folder.h"
#include "satsurf/train/preview.h"
#include "satsurf/train/progress.h"
#include "satsurf/train/reconstruct.h"
#include "satsurf/train/record.h"
#include "satsurf/train/surface_view.h"
#include "satsurf/train/views.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <limits>
#include <optional>
#include <utility>

namespace satsurf::train {
namespace {

namespace fs = std::filesystem;

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr double kWorstFit = 0.1;  // px, of a camera by its quadratics; more shows in the heights

/// Smallest and largest element of one column of [P 3].
std::pair<double, double> column_range(const Tensor& means, Index column) {
  double low = INFINITY, high = -INFINITY;
  for (Index i = column; i < means.count(); i += 3)
    if (std::isfinite(means[i]))
      low = std::min(low, static_cast<double>(means[i])),
      high = std::max(high, static_cast<double>(means[i]));
  return {low, high};
}

/// Heights above the ellipsoid on the grid of a local field.
void write_field(const fs::path& path, const Tensor& values, const HeightField& grid,
                 const rpc::LocalFrame& frame, double offset, const rpc::GeoTags& tags) {
  Tensor out = values.clone();
  for (float& v : out.values()) v = static_cast<float>(static_cast<double>(v) + offset);
  rpc::write_geo_raster(
      path, out,
      {frame.zone.epsg(), grid.x0 + frame.easting0, grid.y0 + frame.northing0, grid.step}, tags);
}

double mean_of(const Tensor& t) {
  double sum = 0, n = 0;
  for (const float v : t.values())
    if (std::isfinite(v)) sum += static_cast<double>(v), n += 1;
  return sum / n;
}

/// throws Error for a picture that is too large to render
void check_cells(const std::string& where, Index width, Index height, const char* hint) {
  constexpr Index kLargest = 1 << 28;  // a GeoTIFF of 1 GB
  if (height > kLargest / width)
    throw Error(where + std::to_string(width) + " x " + std::to_string(height) +
                " pixels to render, wanted fewer than " + std::to_string(kLargest) + hint);
}

void print_plan(const ReconstructPlan& plan, const UserScene& user) {
  const rpc::LocalFrame& frame = user.scene.frame;
  std::printf("height range  %.1f to %.1f m above the ellipsoid, %s\n", user.range.range.low,
              user.range.range.high, user.range.source.c_str());
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
nlohmann::ordered_json memory_by_part(const Reconstruction& made) {
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
  std::vector<Tensor> colours;            ///< [3 H W]
  std::vector<mesh::HeightView> heights;  ///< with the colours of the images; empty unless wanted
};

RenderedViews render_views(const Reconstruction& made, const Scene& scene, bool heights,
                           Progress& progress) {
  RenderedViews out;
  for (std::size_t i = 0; i < scene.views.size(); ++i) {
    progress.update("render", static_cast<double>(i) / static_cast<double>(scene.views.size()));
    if (interrupted()) throw Interrupted{};
    const SceneView& view = scene.views[i];
    SurfaceView seen = rendered_view(made.surfels, view, scene);
    out.colours.push_back(std::move(seen.colour));
    if (heights) out.heights.push_back(std::move(seen.heights));
  }
  progress.update("render", 1);
  return out;
}

void write_pictures(const OutputFolder& folder, const Reconstruction& made, const Scene& scene,
                    const RenderedViews& rendered, Progress& progress) {
  fs::create_directories(folder / "views");
  std::vector<std::pair<std::string, std::function<Tensor()>>> pictures{
      {"height.png", [&] { return height_picture(made.dsm.z); }},
      {"hillshade.png", [&] { return hillshade_picture(made.dsm.z, made.dsm.step); }},
      {"confidence.png", [&] { return confidence_picture(made.confidence); }}};
  progress.update("pictures", 0);
  for (std::size_t i = 0; i < scene.views.size(); ++i) {
    const SceneView& view = scene.views[i];
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
nlohmann::ordered_json write_mesh(const fs::path& file, const std::vector<mesh::HeightView>& seen,
                                  const Reconstruction& made, const rpc::LocalFrame& frame) {
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

}  // namespace

fs::path find_shipped(const std::string& name, const std::string& what, const std::string& flag) {
  std::error_code ignored;
  const fs::path program = fs::read_symlink("/proc/self/exe", ignored).parent_path();
  std::vector<fs::path> places{program.parent_path() / "share/satsurf" / name};
  // a build tree lies inside the sources: build/PRESET/bin
  fs::path up = program;
  for (int level = 0; level < 3; ++level) up = up.parent_path();
  places.push_back(up / "nn/weights" / name);
  std::string looked;
  for (const fs::path& place : places) {
    if (fs::exists(place)) return place;
    looked += (looked.empty() ? "" : ", ") + place.string();
  }
  throw IoError(what + ": none found, wanted one of " + looked + "; give " + flag + " FILE");
}

fs::path find_weights(const fs::path& asked) {
  if (!asked.empty()) return asked;
  if (const char* named = std::getenv("SATSURF_WEIGHTS"); named != nullptr && *named != '\0')
    return named;
  return find_shipped("base8.safetensors", "weights", "--weights");
}

std::vector<std::string> frame_comments(const rpc::LocalFrame& frame) {
  char origin[128];
  std::snprintf(origin, sizeof origin, "origin %.17g %.17g %.17g", frame.easting0, frame.northing0,
                frame.h0);
  return {std::string("satsurf ") + program_version(),
          "crs EPSG:" + std::to_string(frame.zone.epsg()), origin,
          "x east, y north, z up in m from the origin: easting, northing, height above the WGS84 "
          "ellipsoid"};
}

rpc::LocalFrame frame_from_comments(const std::vector<std::string>& comments,
                                    const std::string& where) {
  rpc::LocalFrame frame;
  int epsg = 0;
  bool has_origin = false;
  for (const std::string& line : comments) {
    int code = 0;
    double e = 0, n = 0, h = 0;
    if (std::sscanf(line.c_str(), "crs EPSG:%d", &code) == 1) epsg = code;
    if (std::sscanf(line.c_str(), "origin %lf %lf %lf", &e, &n, &h) == 3) {
      has_origin = std::isfinite(e) && std::isfinite(n) && std::isfinite(h);
      frame.easting0 = e, frame.northing0 = n, frame.h0 = h;
    }
  }
  const int number = epsg % 100;
  if (!has_origin || (epsg / 100 != 326 && epsg / 100 != 327) || number < 1 || number > 60)
    throw IoError(
        where +
        ": no frame in the header, wanted comment lines `crs EPSG:326xx` and `origin E N H`");
  frame.zone = {number, epsg / 100 == 326};
  return frame;
}

void run_reconstruct(const ReconstructCommand& options) {
  constexpr double kLeastSpan = 1;  // m; less holds no surface
  if (const auto& range = options.height_range;
      range && !(range->high - range->low >= kLeastSpan)) {
    char text[120];
    std::snprintf(text, sizeof text,
                  "--height-range: %.10g %.10g, wanted the lower height first and a span of at "
                  "least %g m",
                  range->low, range->high, kLeastSpan);
    throw ConfigError(text);
  }
  const NoGrad no_grad;
  const fs::path weights = find_weights(options.weights);
  std::vector<fs::path> inputs{weights};
  for (const fs::path& file : options.images) {
    const rpc::RasterInfo info = rpc::view_info(file, options.image_dirs);
    inputs.insert(inputs.end(), info.files.begin(), info.files.end());
  }
  std::vector<fs::path> apart = inputs;
  apart.insert(apart.end(), options.image_dirs.begin(), options.image_dirs.end());
  std::optional<OutputFolder> staged;
  if (!options.dry_run)
    staged.emplace(OutputFolder::staged(options.out, options.overwrite, std::move(apart)));
  const nn::Model model = load_model(weights);
  nlohmann::json config{{"images", options.images},
                        {"image_dirs", options.image_dirs},
                        {"weights", weights},
                        {"resolution", options.resolution},
                        {"mesh", options.mesh ? "tsdf" : "none"},
                        {"voxel", options.voxel}};
  if (options.height_range)
    config["height_range"] = {options.height_range->low, options.height_range->high};
  RunRecord record("reconstruct", config, 0);
  if (!options.dry_run)
    for (const fs::path& file : inputs) record.add_input(file);

  Progress progress;
  progress.update("read", 0);
  const auto poll = [] {
    if (interrupted()) throw Interrupted{};
  };
  const UserScene user =
      scene_from_views(options.images, options.image_dirs, options.height_range, poll);
  poll();
  const Scene& scene = user.scene;
  char text[256];
  std::snprintf(text, sizeof text, "height range %.1f to %.1f m above the ellipsoid, %s",
                user.range.range.low, user.range.range.high, user.range.source.c_str());
  progress.note(text);

  const auto start = std::chrono::steady_clock::now();
  ReconstructOptions how;
  how.resolution = options.resolution;
  if (options.mesh) how.mesh = options.voxel;
  how.progress = [&](const std::string& stage, double fraction) {
    poll();
    progress.update(stage, fraction);
  };
  if (options.dry_run) return print_plan(plan_reconstruction(model.config(), scene, how), user);
  OutputFolder& folder = *staged;
  const Reconstruction made = reconstruct(model, scene, how);
  const double seconds =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  if (made.camera_fit_max_px > kWorstFit) {
    std::snprintf(text, sizeof text,
                  "cameras were fitted to %.2f px only, wanted %.1f; the images may be too "
                  "large or the height range too wide",
                  made.camera_fit_max_px, kWorstFit);
    progress.note(text, LogLevel::warning);
  }

  progress.update("write", 0);
  write_field(folder / "dsm.tif", made.dsm.z, made.dsm, scene.frame, scene.frame.h0,
              rpc::ellipsoidal_height("Surface heights"));
  rpc::GeoTags unitless;
  unitless.unit = "", unitless.description = "Confidence of the surface, 0 to 1";
  write_field(folder / "confidence.tif", made.confidence, made.dsm, scene.frame, 0, unitless);
  splat::write_ply(folder / "surfels.ply", made.surfels, frame_comments(scene.frame));
  std::vector<mesh::HeightView> seen;
  {
    RenderedViews rendered = render_views(made, scene, options.mesh, progress);
    write_pictures(folder, made, scene, rendered, progress);
    seen = std::move(rendered.heights);
  }
  if (interrupted()) throw Interrupted{};

  std::vector<float> known;
  for (const float v : made.dsm.z.values())
    if (std::isfinite(v)) known.push_back(v);
  const auto [low, high] = std::minmax_element(known.begin(), known.end());
  const double z_low = known.empty() ? kNan : *low + scene.frame.h0,
               z_high = known.empty() ? kNan : *high + scene.frame.h0;
  const Index H = made.dsm.z.dim(0), W = made.dsm.z.dim(1), surfels = made.surfels.means.dim(0);
  if (known.empty()) {
    std::string names;
    for (const fs::path& file : options.images)
      names += (names.empty() ? "" : ", ") + file.string();
    throw Error("reconstruct: no cell of the surface got a height from " + names +
                ", wanted images that agree; see satsurf info");
  }
  nlohmann::ordered_json mesh_record;  // null without a mesh
  if (options.mesh) {
    progress.update("mesh", 0);
    mesh_record = write_mesh(folder / "mesh.ply", seen, made, scene.frame);
    progress.update("mesh", 1);
    if (interrupted()) throw Interrupted{};
  }
  record.results() = {{"completeness", made.completeness},
                      {"cells", {H, W}},
                      {"resolution", made.dsm.step},
                      {"crs", "EPSG:" + std::to_string(scene.frame.zone.epsg())},
                      {"vertical_datum", "WGS84 ellipsoid"},
                      {"height_range", {user.range.range.low, user.range.range.high}},
                      {"height_range_source", user.range.source},
                      {"lowest", z_low},
                      {"highest", z_high},
                      {"mean_confidence", mean_of(made.confidence)},
                      {"surfels", surfels},
                      {"tiles", made.tiles},
                      {"camera_fit_max_px", made.camera_fit_max_px},
                      {"planned_memory_bytes", made.planned_memory_bytes},
                      {"memory_by_part", memory_by_part(made)},
                      {"mesh", mesh_record},
                      {"reconstruct_seconds", seconds}};
  record.save(folder / "run.json");
  folder.commit();

  std::printf(
      "surface       %td x %td cells of %g m, EPSG:%d, %.1f to %.1f m above the ellipsoid\n", W, H,
      made.dsm.step, scene.frame.zone.epsg(), z_low, z_high);
  std::printf("completeness  %.1f %%\n", 100 * made.completeness);
  std::printf("confidence    %.3f on average\n", mean_of(made.confidence));
  std::printf("surfels       %td from %zu images in %td tile%s\n", surfels, scene.views.size(),
              made.tiles, made.tiles == 1 ? "" : "s");
  if (options.mesh)
    std::printf("mesh          %td faces, voxels of %g m\n", mesh_record["faces"].get<Index>(),
                mesh_record["voxel"].get<double>());
  std::printf("time          %.1f s\n", seconds);
  std::printf("written to    %s\n", options.out.c_str());
}

void run_render(const RenderCommand& options) {
  const std::string extension = options.out.extension().string();
  const bool png = extension == ".png", tif = extension == ".tif" || extension == ".tiff";
  if (!png && !tif)
    throw ConfigError("--out: " + options.out.string() + ", wanted a name ending in .png or .tif");
  std::optional<rpc::RasterInfo> image;
  if (!options.image.empty()) image = rpc::view_info(options.image, options.image_dirs);
  std::vector<fs::path> inputs = image ? image->files : std::vector<fs::path>();
  inputs.push_back(options.surfels);
  check_output_file("--out", options.out, options.overwrite, inputs);
  const NoGrad no_grad;
  const splat::PlyContent content = splat::read_ply(options.surfels);
  const rpc::LocalFrame frame = frame_from_comments(content.comments, options.surfels.string());
  const Tensor& means = content.surfels.means.value();
  const auto [z_low, z_high] = column_range(means, 2);
  if (!(z_low <= z_high))
    throw IoError(options.surfels.string() + ": no surfels, wanted a surface");

  if (image) {
    check_cells(options.image.string() + ": ", image->width, image->height, "");
    const auto render = nn::render_view(
        content.surfels,
        image_camera(*image->rpc, frame, image->width, image->height, z_low, z_high), image->height,
        image->width, 1);
    const auto alpha = render.alpha.value().values();
    if (std::none_of(alpha.begin(), alpha.end(), [](float a) { return a > 0.05f; }))
      throw Error("render: " + options.image.string() + " sees nothing of " +
                  options.surfels.string() + ", wanted an image of that place");
    Tensor colour = render.colour.value().clone();
    if (png) return write_png(options.out, colour);
    for (float& v : colour.values()) v *= 255;
    return rpc::write_rpc_geotiff(options.out, colour, rpc::PixelType::uint8, *image->rpc);
  }

  const double step = options.resolution > 0 ? options.resolution : 0.5;
  const auto [x_low, x_high] = column_range(means, 0);
  const auto [y_low, y_high] = column_range(means, 1);
  const auto W = static_cast<Index>(std::ceil((x_high - x_low) / step)) + 1;
  const auto H = static_cast<Index>(std::ceil((y_high - y_low) / step)) + 1;
  const HeightField grid{
      {}, std::floor(x_low / step) * step, std::ceil(y_high / step) * step, step};
  check_cells("render: ", W, H, "; give a larger --resolution");
  const auto render =
      nn::render_view(content.surfels, nadir_camera(grid.x0, grid.y0, step), H, W, 1);
  if (png) return write_png(options.out, render.colour.value());
  write_field(options.out, surface_heights(render), grid, frame, frame.h0,
              rpc::ellipsoidal_height("Surface heights"));
}

}  // namespace satsurf::train

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/reconstruct_job.h"

#include "satsurf/app/interrupt.h"
#include "satsurf/app/pointing_text.h"
#include "satsurf/app/surface_files.h"
#include "satsurf/core/files.h"
#include "satsurf/core/memory.h"
#include "satsurf/core/nearest.h"
#include "satsurf/core/parallel.h"
#include "satsurf/core/safetensors.h"
#include "satsurf/nn/shipped_weights.h"
#include "satsurf/nn/weights_file.h"
#include "satsurf/rpc/geoid.h"
#include "satsurf/scene/pointing_file.h"

#include <cstdio>
#include <memory>
#include <utility>

#include <fmt/format.h>

namespace satsurf::app {
namespace {

namespace fs = std::filesystem;

/// The heights to search, if any were asked for.
/// throws  ConfigError for a range that holds no surface
std::optional<rpc::HeightRange> range_of(const ReconstructConfig& config) {
  if (!config.height_range) return std::nullopt;
  const rpc::HeightRange range{(*config.height_range)[0], (*config.height_range)[1]};
  scene::check_height_range(range);
  return range;
}

/// The system that the rasters shall have, if one was asked for.
/// throws  ConfigError for one that no raster of a surface can have
std::optional<rpc::ProjectedCrs> crs_of(const ReconstructConfig& config) {
  if (config.crs == "auto") return std::nullopt;
  return rpc::projected_crs(config.crs);
}

/// What to do about cameras that disagree.
/// throws  IoError for a file that is none of shifts; ConfigError for a word that is none of them
scene::PointingChoice pointing_of(const ReconstructConfig& config) {
  if (config.pointing == "shift") return {};
  if (config.pointing == "affine") return {.affine = true};
  if (config.pointing == "off") return {.measure = false};
  if (!path_exists(config.pointing))
    if (const auto meant = nearest(config.pointing, {"shift", "affine", "off"}))
      throw ConfigError("pointing is '" + config.pointing + "', did you mean '" + *meant +
                        "'? expected one of shift, affine, off or a file of shifts");
  return {.given = scene::read_pointing(config.pointing)};
}

/// throws  IoError, ConfigError
scene::ViewRules rules_of(const ReconstructConfig& config) {
  scene::ViewRules rules;
  rules.validity.nodata = config.nodata;
  rules.pointing = pointing_of(config);
  rules.most_views = config.max_views;
  if (!config.mask.empty())
    rules.mask = std::make_shared<rpc::GroundMask>(config.mask, config.mask_values);
  else if (!config.mask_values.empty())
    throw ConfigError("mask_values came without mask, expected the raster that has them");
  if (!config.dem.empty()) {
    if (config.height_range)
      throw ConfigError("height_range and dem came, expected one of them to say the heights");
    rules.terrain = std::make_shared<rpc::Terrain>(config.dem);
  }
  return rules;
}

fs::path weights_of(const ReconstructConfig& config) {
  return config.weights.empty()
             ? nn::shipped_weights(nn::ShippedNetwork::cascade, "give --weights FILE")
             : config.weights;
}

/// Before the work, not after it: a grid that is missing is told at once.
/// throws  IoError
void check_geoid(const ReconstructConfig& config) {
  if (config.geoid != Geoid::none) rpc::geoid_heights(datum_of(config.geoid), {{{0, 0}}});
}

/// throws  IoError
Networks networks_of(const fs::path& weights) {
  const TensorFile file = load_safetensors(weights);
  return {nn::model_from(file, weights.string()), nn::surface_from(file, weights.string())};
}

/// What was asked for, for the record.
nlohmann::json config_json(ReconstructConfig config, const fs::path& weights,
                           const scene::PointingChoice& pointing) {
  config.weights = weights;
  if (pointing.given) config.pointing = in_full(config.pointing).string();
  return recorded_config(config);
}

std::optional<OutputFolder> staged_folder(const ReconstructJob& job) {
  const ReconstructCommand& options = job.options;
  if (options.dry_run) return std::nullopt;
  std::vector<fs::path> apart{job.weights};
  apart.insert(apart.end(), options.images.begin(), options.images.end());
  apart.insert(apart.end(), options.image_dirs.begin(), options.image_dirs.end());
  apart.push_back(options.config_file);
  if (job.rules.pointing.given) apart.push_back(options.pointing);
  for (const fs::path& file : {options.aoi, options.mask, options.dem}) apart.push_back(file);
  return OutputFolder::staged(options.out, options.overwrite, std::move(apart));
}

void note_range(const scene::RangeChoice& choice, Progress& progress) {
  progress.note(fmt::format("height range {:.1f} to {:.1f} m above the ellipsoid, {}",
                            choice.height_range.low, choice.height_range.high, choice.source));
}

/// Says how the cameras agree and what was done about it; warns where shifted cameras see the ground
/// outside the range that was asked for.
void note_pointing(const scene::UserScene& user, Progress& progress) {
  if (!user.pointing) return;
  const scene::Pointing& pointing = *user.pointing;
  if (!pointing.after.empty()) progress.note(pointing_line(pointing));
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
  constexpr double kWorthTelling = 0.001;  // of an image; what is written with one decimal of a %
  for (const scene::View& view : scene.views)
    if (view.border >= kWorthTelling)
      progress.note(fmt::format("{}: a border of one value, {:.1f} % of the image, is left out",
                                view.label(), 100 * view.border));
}

/// Says which images are not used.
void note_left_out(const scene::UserScene& user, Progress& progress) {
  for (const scene::LeftOut& left : user.left_out)
    progress.note(left.label + " is left out: " + left.why);
}

std::string time_text(double seconds) {
  if (seconds < 90) return fmt::format("{:.0f} s", seconds);
  if (seconds < 5400) return fmt::format("{:.0f} min", seconds / 60);
  return fmt::format("{:.1f} h", seconds / 3600);
}

nlohmann::json left_out_json(const scene::UserScene& user) {
  auto list = nlohmann::json::array();
  for (const scene::LeftOut& left : user.left_out)
    list.push_back({{"image", left.label}, {"why", left.why}});
  return list;
}

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

/// Share of the compared heights that agreed; null where none was compared.
nlohmann::json height_agreement(const SurfaceFacts& facts) {
  if (facts.compared == 0) return nullptr;
  return static_cast<double>(facts.agreed) / static_cast<double>(facts.compared);
}

/// Ground of a number of cells, m².
double area(const SurfaceFacts& facts, Index cells) {
  return static_cast<double>(cells) * facts.resolution * facts.resolution;
}

}  // namespace

ReconstructJob::ReconstructJob(const ReconstructCommand& asked)
    : options(asked),
      height_range(range_of(asked)),
      crs(crs_of(asked)),
      max_memory(asked.max_memory.empty() ? 0 : memory_from_text(asked.max_memory, "max_memory")),
      weights(weights_of(asked)),
      rules(rules_of(asked)),
      staged(staged_folder(*this)),
      record("reconstruct", config_json(asked, weights, rules.pointing), 0),
      networks(networks_of(weights)),
      warnings(progress, record) {
  check_geoid(asked);
}

reconstruct::ReconstructOptions ReconstructJob::how(const rpc::LocalFrame& frame) const {
  reconstruct::ReconstructOptions out;
  out.surface = options.surface;
  out.network = networks.surface ? &*networks.surface : nullptr;
  out.resolution = options.resolution;
  out.level_water = options.water == Water::level;
  out.even_untextured = options.untextured == Untextured::even;
  out.max_memory = max_memory;
  if (rules.mask)
    out.unwanted = [mask = rules.mask, frame](const reconstruct::Grid& grid) {
      return mask->on(
          {frame.zone.epsg(), grid.east + frame.easting0, grid.north + frame.northing0, grid.step},
          grid.height, grid.width);
    };
  return out;
}

std::vector<fs::path> ReconstructJob::inputs(const scene::Scene& scene) const {
  std::vector<fs::path> out{weights};
  if (rules.pointing.given) out.push_back(options.pointing);
  for (const fs::path& file : {options.aoi, options.mask, options.dem})
    if (!file.empty()) out.push_back(file);
  for (const scene::View& view : scene.views)
    out.insert(out.end(), view.files.begin(), view.files.end());
  return out;
}

void ReconstructJob::settle_crs(const scene::UserScene& user) {
  if (!crs) return;
  const rpc::LocalFrame& frame = user.scene.frame;
  const auto [lon, lat] = rpc::geodetic_from_utm(frame.zone, frame.easting0, frame.northing0);
  rpc::check_area_of_use(*crs, lon, lat);
  if (crs->epsg == frame.zone.epsg()) crs.reset();
}

void ReconstructJob::bring_rasters(const rpc::GeoGrid& grid, SurfaceFacts& facts) {
  const auto [rows, columns] =
      bring_into(*crs, staged->path(), grid, facts.rows, facts.columns, [&](double share) {
        stop_if_interrupted();
        progress.update("project", share);
      });
  facts.crs = crs->label, facts.rows = rows, facts.columns = columns;
}

void ReconstructJob::note_scene(const scene::UserScene& user) {
  note_left_out(user, progress);
  note_pointing(user, progress);
  note_range(user.range, progress);
  if (!user.range.trouble.empty())
    warnings.add(reconstruct::Warning{
        "dem_unused",
        "the terrain says no heights: " + user.range.trouble + "; they are " + user.range.source});
  note_borders(user.scene, progress);
  warnings.add(reconstruct::scene_warnings(user.scene));
  if (user.pointing) warnings.add(reconstruct::pointing_warnings(*user.pointing, user.scene));
  warnings.add(reconstruct::range_warnings(user));
  if (!staged) return;
  const std::vector<fs::path> files = inputs(user.scene);
  staged->add_inputs(files);
  for (const fs::path& file : files) record.add_input(file);
}

void print_plan_ground(const scene::UserScene& user, const rpc::HeightRange& searched,
                       const reconstruct::Ground& ground,
                       const std::optional<rpc::ProjectedCrs>& crs) {
  const rpc::LocalFrame& frame = user.scene.frame;
  std::printf("height range  %.1f to %.1f m above the ellipsoid, %s\n", user.range.height_range.low,
              user.range.height_range.high, user.range.source.c_str());
  if (searched != user.scene.z_range) {
    const rpc::HeightRange heights = frame.heights_from_z(searched);
    std::printf("  of it       %.1f to %.1f m is searched\n", heights.low, heights.high);
  }
  std::printf("ground        EPSG:%d, east %.0f to %.0f, north %.0f to %.0f (%.0f m x %.0f m)\n",
              frame.zone.epsg(), ground.x0 + frame.easting0, ground.x1 + frame.easting0,
              ground.y0 + frame.northing0, ground.y1 + frame.northing0, ground.width(),
              ground.height());
  if (crs) std::printf("rasters       %s, by resampling\n", crs->label.c_str());
}

void print_plan_time(const PlannedWork& work) {
  // Seconds of one thread, measured with the shipped weights on an AMD EPYC with AVX-512: for a
  // megapixel that the network sees, and for each image that it compares it with; for a million cells
  // and columns of voxels, their files included; and of the run for what is small.
  constexpr double kMegapixel = 1.9, kInTiles = 0.3, kView = 0.68, kCells = 4, kColumns = 3;
  constexpr double kSmall = 0.6;
  const double megapixel = kMegapixel + (work.in_tiles ? kInTiles : 0) +
                           kView * static_cast<double>(work.views),
               cells = 1e-6 * work.cells, beside = kSmall + work.so_far;
  const double seconds =
      beside +
      (megapixel * work.megapixels + kCells * cells + 1e-6 * kColumns * work.columns) / threads();
  std::printf(
      "time          about %s on %d threads, of one %.1f s for each of %.1f megapixels and %.1f s "
      "for each of %.1f million cells, estimated; %.1f s beside\n",
      time_text(seconds).c_str(), threads(), megapixel, work.megapixels, kCells, cells, beside);
}

nlohmann::json results_json(const SurfaceFacts& facts, const scene::UserScene& user) {
  return {{"completeness", facts.completeness},
          {"cells", {facts.rows, facts.columns}},
          {"resolution", facts.resolution},
          {"crs", facts.crs},
          {"frame_crs", "EPSG:" + std::to_string(user.scene.frame.zone.epsg())},
          {"vertical_datum", rpc::datum_text(facts.datum)},
          {"height_range", {user.range.height_range.low, user.range.height_range.high}},
          {"height_range_source", user.range.source},
          {"height_range_searched", {facts.searched.low, facts.searched.high}},
          {"pointing", user.pointing ? pointing_json(*user.pointing) : nlohmann::ordered_json()},
          {"lowest", facts.heights.low},
          {"highest", facts.heights.high},
          {"mean_confidence", facts.mean_confidence},
          {"levelled_area", area(facts, facts.levelled)},
          {"evened_area", area(facts, facts.evened)},
          {"image_correlation", facts.image_correlation},
          {"height_agreement", height_agreement(facts)},
          {"surfels", facts.surfels},
          {"tiles", facts.tiles},
          {"images", images_json(user.scene)},
          {"left_out", left_out_json(user)},
          {"camera_fit_max_px", facts.camera_fit_max_px},
          {"planned_memory_bytes", facts.planned_memory_bytes},
          {"mesh", facts.mesh},
          {"reconstruct_seconds", facts.seconds}};
}

void print_summary(const SurfaceFacts& facts, const scene::Scene& scene, double wall_seconds,
                   const fs::path& out) {
  std::printf("surface       %td x %td cells of %g m, %s, %.1f to %.1f m above the ellipsoid\n",
              facts.columns, facts.rows, facts.resolution, facts.crs.c_str(), facts.heights.low,
              facts.heights.high);
  std::printf("completeness  %.1f %%\n", 100 * facts.completeness);
  std::printf("confidence    %.3f on average\n", facts.mean_confidence);
  if (facts.levelled > 0)
    std::printf("water         %.0f m² made level with the shore\n", area(facts, facts.levelled));
  if (facts.evened > 0)
    std::printf("untextured    %.0f m² in doubt go along with their rims\n",
                area(facts, facts.evened));
  std::printf("surfels       %td from %zu images in %td tile%s\n", facts.surfels,
              scene.views.size(), facts.tiles, facts.tiles == 1 ? "" : "s");
  if (!facts.mesh.is_null())
    std::printf("mesh          %td faces, voxels of %g m\n", facts.mesh["faces"].get<Index>(),
                facts.mesh["voxel"].get<double>());
  std::printf("time          %.1f s, %.1f s of them for the surface\n", wall_seconds,
              facts.seconds);
  std::printf("written to    %s\n", out.c_str());
}

void refuse_no_heights(const std::vector<fs::path>& images) {
  std::string names;
  for (const fs::path& file : images) names += (names.empty() ? "" : ", ") + file.string();
  throw Error("no cell of the surface got a height from " + names +
              ", expected images that agree; see satsurf info");
}

void check_coverage(double completeness, const ReconstructCommand& options) {
  if (completeness >= options.min_coverage) return;
  throw Error(
      fmt::format("{:.1f} % of the common ground has a height, expected {:.1f} % by "
                  "--min-coverage; the surface is in {}",
                  100 * completeness, 100 * options.min_coverage, options.out.string()));
}

}  // namespace satsurf::app

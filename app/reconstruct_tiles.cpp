// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/interrupt.h"
#include "satsurf/app/legend.h"
#include "satsurf/app/preview.h"
#include "satsurf/app/products.h"
#include "satsurf/app/reconstruct_job.h"
#include "satsurf/app/reconstruct_report.h"
#include "satsurf/app/tile_store.h"
#include "satsurf/app/tiled_files.h"
#include "satsurf/core/block_pool.h"
#include "satsurf/core/isa.h"
#include "satsurf/core/memory.h"
#include "satsurf/core/version.h"
#include "satsurf/mesh/ply.h"
#include "satsurf/mesh/simplify.h"
#include "satsurf/reconstruct/rendered_view.h"
#include "satsurf/reconstruct/tile.h"
#include "satsurf/rpc/area.h"
#include "satsurf/scene/crop.h"
#include "satsurf/scene/pointing_file.h"
#include "satsurf/scene/survey.h"
#include "satsurf/scene/terrain.h"
#include "satsurf/splat/select.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <functional>
#include <future>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

namespace satsurf::app {
namespace {

namespace fs = std::filesystem;
using reconstruct::Tile;
using reconstruct::Tiling;
using Clock = std::chrono::steady_clock;

constexpr std::size_t kBlockCache = std::size_t{128} << 20;  // bytes
constexpr double kLargeCells = 25e6;  // from here on surfels are thinned to as many
constexpr double kAssembly = 0.02;    // of the time of all tiles that putting them together takes

double seconds_since(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

/// Whether the line between two points passes a rectangle.
/// low, high  corners of it
bool passes(const std::array<double, 2>& a, const std::array<double, 2>& b,
            const std::array<double, 2>& low, const std::array<double, 2>& high) {
  double enter = 0, leave = 1;  // parts of the line
  for (std::size_t k = 0; k < 2; ++k) {
    const double d = b[k] - a[k];
    if (d == 0) {
      if (a[k] < low[k] || a[k] > high[k]) return false;
      continue;
    }
    const double t0 = (low[k] - a[k]) / d, t1 = (high[k] - a[k]) / d;
    enter = std::max(enter, std::min(t0, t1)), leave = std::min(leave, std::max(t0, t1));
  }
  return enter <= leave;
}

/// The part of the ground that is wanted.
struct Wanted {
  std::optional<rpc::Area> polygons;            ///< what of it counts; none for all of a rectangle
  std::optional<reconstruct::Ground> ground{};  ///< around it, local m

  /// Whether any of it lies in a rectangle.
  bool meets(const reconstruct::Ground& box, const rpc::LocalFrame& frame) const {
    if (!polygons) return true;
    const std::array<double, 2> low{box.x0 + frame.easting0, box.y0 + frame.northing0},
        high{box.x1 + frame.easting0, box.y1 + frame.northing0};
    for (const auto& ring : polygons->rings)
      for (std::size_t i = 0, j = ring.size() - 1; i < ring.size(); j = i++)
        if (passes(ring[j], ring[i], low, high)) return true;
    return polygons->contains(0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]));
  }
};

/// throws  IoError, ConfigError
Wanted wanted_ground(const ReconstructCommand& options, const rpc::LocalFrame& frame) {
  Wanted out;
  std::optional<rpc::Area> area;
  if (!options.aoi.empty())
    area = out.polygons = rpc::read_area(options.aoi, frame.zone, stop_if_interrupted);
  else if (!options.bbox.empty())
    area = rpc::area_of_box({options.bbox[0], options.bbox[1], options.bbox[2], options.bbox[3]},
                            frame.zone);
  if (!area) return out;
  const auto [x0, y0, x1, y1] = area->bounds();
  out.ground = {x0 - frame.easting0, y0 - frame.northing0, x1 - frame.easting0,
                y1 - frame.northing0};
  return out;
}

void print_plan(const Tiling& tiling, const scene::Survey& survey, const ReconstructJob& job) {
  print_plan_ground(survey.user, survey.user.scene.z_range, tiling.grid.ground(), job.crs);
  std::printf("surface       %td x %td cells of %g m\n", tiling.grid.width, tiling.grid.height,
              tiling.grid.step);
  const double turned = tiling.axes.degrees();
  std::printf(
      "tiles         %td x %td%s, each with windows of about %td x %td px, at most %td x %td, of "
      "%td images\n",
      tiling.columns, tiling.rows,
      turned != 0 ? fmt::format(", turned by {:g} degrees as the images are", turned).c_str() : "",
      tiling.expected_window.width, tiling.expected_window.height, tiling.window, tiling.window,
      tiling.views);
  std::printf("memory        about %s; %s are free\n", memory_text(tiling.memory_bytes).c_str(),
              memory_text(static_cast<double>(available_memory())).c_str());
  double cells = 0;
  for (const reconstruct::Tile& tile : tiling.tiles)
    cells += static_cast<double>(tile.all.width()) * static_cast<double>(tile.all.height());
  print_plan_time({.megapixels = tiling.megapixels,
                   .views = tiling.views,
                   .cells = cells,
                   .in_tiles = true,
                   .so_far = job.record.seconds()});
}

/// throws  Error where the system has less memory than the plan needs
void check_memory(const Tiling& tiling) {
  satsurf::check_memory(fmt::format("tiles of {} x {} px need", tiling.expected_window.width,
                                    tiling.expected_window.height),
                        tiling.memory_bytes, "--max-memory makes them smaller",
                        static_cast<double>(tensor_bytes()));
}

/// What the tiles of a run depend on: a run that goes on with them must have the same.
nlohmann::json plan_json(const ReconstructJob& job, const scene::Survey& survey,
                         const Tiling& tiling) {
  auto files = nlohmann::json::array();
  for (const fs::path& file : job.inputs(survey.user.scene)) {
    std::error_code error;
    files.push_back({{"path", fs::absolute(file).string()},
                     {"bytes", fs::file_size(file, error)},
                     {"changed", fs::last_write_time(file, error).time_since_epoch().count()}});
  }
  auto shifts = nlohmann::json::array();
  if (const auto& pointing = survey.user.pointing)
    for (std::size_t i = 0; i < pointing->shifts.size(); ++i)
      shifts.push_back({pointing->shifts[i].x, pointing->shifts[i].y, pointing->slope(i).at.x,
                        pointing->slope(i).at.y, pointing->slope(i).per_pixel});
  const rpc::LocalFrame& frame = survey.user.scene.frame;
  const reconstruct::Grid& grid = tiling.grid;
  return {{"config", job.record.json()["config"]},
          {"inputs", files},
          {"version", program_version()},
          {"git", program_git_hash()},
          {"isa", isa_name(active_isa())},
          {"zone", frame.zone.epsg()},
          {"origin", {frame.easting0, frame.northing0, frame.h0}},
          {"z_range", {survey.user.scene.z_range.low, survey.user.scene.z_range.high}},
          {"shifts", shifts},
          {"grid", {grid.east, grid.north, grid.step, grid.height, grid.width}},
          {"tiles",
           {tiling.rows, tiling.columns, tiling.overlap, tiling.window, tiling.axes.degrees()}}};
}

/// The most surfels that one tile may have, 0 for all: its share of those of the whole.
Index surfels_of_tile(const Tiling& tiling, const Tile& tile, Index most) {
  const double cells = static_cast<double>(tiling.grid.width * tiling.grid.height);
  if (most == 0 && cells > kLargeCells) most = static_cast<Index>(kLargeCells);
  if (most == 0) return 0;
  const double share = (tile.end[0] - tile.begin[0]) * (tile.end[1] - tile.begin[1]) / cells;
  return std::max<Index>(1, static_cast<Index>(static_cast<double>(most) * share));
}

/// The reduced copies with cameras that hold at some heights, local m.
std::vector<nn::PosedImage> posed_copies(const scene::Scene& copies,
                                         const rpc::HeightRange& z_range) {
  std::vector<nn::PosedImage> out;
  for (const scene::View& view : copies.views)
    out.push_back(scene::posed_image(view, copies.frame, z_range));
  return out;
}

/// Makes the tiles that are not there yet. While one is worked on the windows of the next are read
/// and the one before is written.
class TileMaker {
 public:
  TileMaker(ReconstructJob& job, const scene::Survey& survey, const Tiling& tiling,
            const Wanted& wanted, TileStore& store)
      : job_(job),
        survey_(survey),
        tiling_(tiling),
        wanted_(wanted),
        store_(store),
        exposures_(exposures_of_copies(survey.user.scene)) {}

  /// returns  what became of every tile
  std::vector<TileRecord> run() {
    std::vector<TileRecord> records(tiling_.tiles.size());
    std::vector<std::size_t> left;
    for (std::size_t k = 0; k < tiling_.tiles.size(); ++k)
      if (auto found = store_.find(tiling_.tiles[k]))
        records[k] = *found;
      else
        left.push_back(k);
    if (left.size() < records.size())
      job_.progress.note(fmt::format("{} of {} tiles are there already",
                                     records.size() - left.size(), records.size()));
    std::future<scene::WindowedScene> ahead;
    if (!left.empty()) ahead = read(left[0]);
    for (std::size_t n = 0; n < left.size(); ++n) {
      const scene::WindowedScene part = ahead.get();
      if (n + 1 < left.size()) ahead = read(left[n + 1]);
      done_ = n, all_ = left.size(), first_ = records.size() - left.size();
      records[left[n]] = make(tiling_.tiles[left[n]], part);
    }
    if (written_.valid()) written_.get();
    return records;
  }

 private:
  /// Of the whole images: a cloud over all of a tile could not be told by the tile alone.
  static reconstruct::Exposures exposures_of_copies(const scene::Scene& copies) {
    return reconstruct::exposures_of(posed_copies(copies, copies.z_range), copies.z_range.middle());
  }

  std::future<scene::WindowedScene> read(std::size_t k) const {
    return std::async(std::launch::async, [this, k] {
      const reconstruct::Ground box = tiling_.grid_of(tiling_.tiles[k].all).ground();
      if (!wanted_.meets(box, survey_.user.scene.frame)) return scene::WindowedScene{};
      return scene::read_windows(survey_, tiling_.ground_of(tiling_.tiles[k]), range_over(box));
    });
  }

  /// Heights to search over a part of the ground: by the terrain, where it says any that the whole
  /// range holds.
  rpc::HeightRange range_over(const reconstruct::Ground& ground) const {
    const scene::Scene& whole = survey_.user.scene;
    const rpc::LocalFrame& frame = whole.frame;
    if (!job_.rules.terrain || !survey_.user.range.trouble.empty()) return whole.z_range;
    const scene::TerrainRange by =
        scene::terrain_range(*job_.rules.terrain, frame.zone,
                             {ground.x0 + frame.easting0, ground.y0 + frame.northing0,
                              ground.x1 + frame.easting0, ground.y1 + frame.northing0});
    if (!by.height_range) return whole.z_range;
    const rpc::HeightRange z = frame.z_from_heights(*by.height_range);
    const rpc::HeightRange out{std::max(z.low, whole.z_range.low),
                               std::min(z.high, whole.z_range.high)};
    return out.has_span() ? out : whole.z_range;
  }

  void report(double part) const {
    stop_if_interrupted();
    job_.progress.update(
        "tiles", (1 - kAssembly) * (static_cast<double>(done_) + part) / static_cast<double>(all_),
        fmt::format("tile {} of {}", first_ + done_ + 1, first_ + all_));
  }

  /// What of the tiles' cells is asked for; empty for all.
  std::function<Tensor(const reconstruct::Grid&)> inside() const {
    if (!wanted_.polygons) return {};
    return [this](const reconstruct::Grid& grid) {
      return wanted_.polygons->cells(geo_grid(grid, survey_.user.scene.frame), grid.height,
                                     grid.width);
    };
  }

  TileRecord make(const Tile& tile, const scene::WindowedScene& part) {
    const auto start = Clock::now();
    report(0);
    reconstruct::ReconstructOptions how = job_.how(survey_.user.scene.frame);
    how.resolution = tiling_.grid.step;
    how.progress = [&](const std::string& stage, double fraction) {
      report(stage == "surface" ? 0.8 + 0.1 * fraction : 0);
    };
    TileRecord record;
    auto surface = std::make_shared<reconstruct::TileSurface>();
    try {
      *surface = reconstruct::reconstruct_tile(job_.networks.model, part, tiling_, tile, exposures_,
                                               how, inside());
    } catch (const IoError&) {
      throw;
    } catch (const Error& e) {
      // It is not put down, so that --resume --overwrite tries it again.
      job_.warnings.add(reconstruct::Warning{
          "tile_failed", fmt::format("tile {} {}: {}", tile.row, tile.column, e.what())});
      record.status = "failed", record.error = e.what();
      record.expected = reconstruct::cells_to_find(part, tiling_, tile, how, inside());
      record.seconds = seconds_since(start);
      return record;
    }
    if (!surface->empty) {
      record.status = "done";
      for (const scene::View& view : part.scene.views) record.views.push_back(view.name);
      record.found = surface->found, record.expected = surface->expected;
      record.compared = surface->compared, record.agreed = surface->agreed;
      record.levelled = surface->levelled, record.evened = surface->evened;
      record.window = surface->window, record.z_range = surface->z_range;
      record.camera_fit_max_px = surface->camera_fit_max_px;
      if (!surface->surfels.means.empty()) {
        const Index most = surfels_of_tile(tiling_, tile, job_.options.max_surfels);
        if (most > 0) surface->surfels = splat::thinned(surface->surfels, most);
        record.surfels = surface->surfels.means.dim(0);
      }
    }
    record.seconds = seconds_since(start);
    if (written_.valid()) written_.get();
    written_ = std::async(std::launch::async,
                          [this, &tile, record, surface] { store_.save(tile, record, *surface); });
    return record;
  }

  ReconstructJob& job_;
  const scene::Survey& survey_;
  const Tiling& tiling_;
  const Wanted& wanted_;
  TileStore& store_;
  reconstruct::Exposures exposures_;
  std::future<void> written_;
  std::size_t done_ = 0, all_ = 0, first_ = 0;  ///< of the tiles that are left, and those before
};

/// What became of all tiles. Of a run that is stopped it says that they are kept.
std::vector<TileRecord> made_tiles(ReconstructJob& job, const scene::Survey& survey,
                                   const Tiling& tiling, const Wanted& wanted, TileStore& store) {
  try {
    return TileMaker(job, survey, tiling, wanted, store).run();
  } catch (...) {
    if (store.any())
      job.progress.note("finished tiles are kept in " + store.path().string() +
                        "; the same command with --resume goes on with them");
    throw;
  }
}

/// The table of tiles in the record.
nlohmann::ordered_json table_json(const Tiling& tiling, const std::vector<TileRecord>& records,
                                  const rpc::LocalFrame& frame) {
  auto table = nlohmann::ordered_json::array();
  for (std::size_t k = 0; k < records.size(); ++k) {
    const TileRecord& r = records[k];
    const Tile& tile = tiling.tiles[k];
    const reconstruct::Ground g = tiling.grid_of(tile.core).ground();
    nlohmann::ordered_json row{
        {"row", tile.row},
        {"column", tile.column},
        {"ground",
         {g.x0 + frame.easting0, g.y0 + frame.northing0, g.x1 + frame.easting0,
          g.y1 + frame.northing0}},
        {"status", r.status},
        {"seconds", r.seconds},
        {"completeness",
         r.expected > 0 ? static_cast<double>(r.found) / static_cast<double>(r.expected) : 0.0}};
    if (tiling.axes.sine != 0) {
      auto corners = nlohmann::ordered_json::array();
      const scene::Polygon ground = tiling.corners_of(tile);
      for (auto at = ground.rbegin(); at != ground.rend(); ++at)  // from the north-west, clockwise
        corners.push_back({(*at)[0] + frame.easting0, (*at)[1] + frame.northing0});
      row["corners"] = std::move(corners);
    }
    if (r.status == "done") {
      const rpc::HeightRange heights = frame.heights_from_z(r.z_range);
      row["height_range_searched"] = {heights.low, heights.high};
      row["window"] = {r.window.height, r.window.width};
      row["surfels"] = r.surfels, row["images"] = r.views;
    }
    if (!r.error.empty()) row["error"] = r.error;
    table.push_back(std::move(row));
  }
  return table;
}

/// What is said of the surface: counts of the tiles and what putting them together has found.
SurfaceFacts facts_of(const Tiling& tiling, const std::vector<TileRecord>& records,
                      const TiledSurface& made, const rpc::LocalFrame& frame) {
  SurfaceFacts facts;
  Index found = 0, expected = 0;
  rpc::HeightRange searched{INFINITY, -INFINITY};
  for (const TileRecord& r : records) {
    found += r.found, expected += r.expected, facts.surfels += r.surfels;
    facts.compared += r.compared, facts.agreed += r.agreed, facts.levelled += r.levelled;
    facts.evened += r.evened;
    facts.camera_fit_max_px = std::max(facts.camera_fit_max_px, r.camera_fit_max_px);
    if (r.status != "done") continue;
    searched = hull(searched, r.z_range);
    ++facts.tiles;
  }
  facts.completeness =
      expected > 0 ? static_cast<double>(found) / static_cast<double>(expected) : 0;
  facts.resolution = tiling.grid.step;
  facts.mean_confidence = made.mean_confidence;
  facts.rows = tiling.grid.height, facts.columns = tiling.grid.width;
  facts.searched = frame.heights_from_z(searched);
  facts.heights = made.heights;
  facts.planned_memory_bytes = tiling.memory_bytes;
  return facts;
}

/// What the warnings of a surface and its report are made of: a reduced copy.
reconstruct::Reconstruction overview_of(const SurfaceOverview& made, const SurfaceFacts& facts,
                                        const scene::Scene& scene) {
  reconstruct::Reconstruction out;
  out.frame = scene.frame, out.z_range = scene.frame.z_from_heights(facts.searched);
  out.dsm = made.dsm, out.confidence = made.confidence, out.sigma = made.sigma;
  out.completeness = facts.completeness, out.camera_fit_max_px = facts.camera_fit_max_px;
  return out;
}

/// The reduced copies under the cameras of the images, whose pixels are the ones to judge.
scene::UserScene with_whole_cameras(const scene::Survey& survey) {
  scene::UserScene out = survey.user;
  for (std::size_t i = 0; i < survey.views.size(); ++i)
    out.scene.views[i].rpc = survey.views[i].rpc;
  return out;
}

/// small   of which the renders are made
/// copies  the reduced images
/// posed   these with their cameras
void write_pictures(const OutputFolder& folder, const TiledSurface& made,
                    const SurfaceOverview& small, const scene::Scene& copies,
                    const std::vector<nn::PosedImage>& posed, Progress& progress) {
  const rpc::GeoGrid grid = geo_grid(made.dsm, copies.frame);
  const ColourScale heights = height_scale(made.dsm.z, copies.frame.h0), sure = confidence_scale();
  write_map(folder / "height.png", height_picture(made.dsm.z), &heights, grid);
  write_map(folder / "hillshade.png", hillshade_picture(made.dsm.z, made.dsm.step), nullptr, grid);
  write_map(folder / "confidence.png", confidence_picture(made.confidence), &sure, grid);
  fs::create_directories(folder / "views");
  for (std::size_t i = 0; i < posed.size(); ++i) {
    const scene::View& view = copies.views[i];
    stop_if_interrupted();
    progress.update("pictures", static_cast<double>(i) / static_cast<double>(posed.size()));
    write_png(folder / "views" / (view.name + "_source.png"), view.rgb);
    write_png(folder / "views" / (view.name + "_render.png"),
              reconstruct::draped_view(small.dsm, small.ortho, posed[i]));
  }
}

/// Triangles between the heights of a reduced copy, of at most two million faces: a mesh of all of a
/// large surface neither fits into the memory nor opens in a viewer.
/// voxel  least side of a cell, m; 0 for two of the surface's
nlohmann::ordered_json write_mesh(const fs::path& file, const SurfaceOverview& small, double step,
                                  double voxel, const rpc::LocalFrame& frame) {
  constexpr Index kMost = 1000;  // cells a side
  const auto start = Clock::now();
  const Index side = std::max(small.dsm.z.dim(0), small.dsm.z.dim(1));
  const double least = voxel > 0 ? voxel : 2 * step;
  const Index block = std::max({Index{1}, (side + kMost - 1) / kMost,
                                static_cast<Index>(std::lround(least / small.dsm.step))});
  const double cell = small.dsm.step * static_cast<double>(block);
  const mesh::Mesh surface =
      mesh::mesh_from_heights(block_means(small.dsm.z, block), small.dsm.x0, small.dsm.y0, cell,
                              block_means(small.ortho, block));
  mesh::write_ply(file, surface, frame_comments(frame));
  return {{"voxel", cell},
          {"vertices", surface.vertices.size()},
          {"faces", surface.faces.size()},
          {"seconds", seconds_since(start)}};
}

}  // namespace

void reconstruct_tiles(ReconstructJob& job) {
  const ReconstructCommand& options = job.options;
  Progress& progress = job.progress;
  rpc::limit_block_cache(kBlockCache);
  std::optional<TileStore> store;
  if (!options.dry_run) store.emplace(options.out, options.resume, options.overwrite);
  progress.update("read", 0);
  const scene::Survey survey = scene::survey_views(
      options.images, options.image_dirs, job.height_range, stop_if_interrupted, job.rules);
  const scene::Scene& scene = survey.user.scene;
  const Wanted wanted = wanted_ground(options, scene.frame);
  const Tiling tiling = reconstruct::plan_tiles(job.networks.model.config(), survey,
                                                job.how(scene.frame), wanted.ground);
  job.settle_crs(survey.user);
  if (store)
    store->begin(plan_json(job, survey, tiling));  // before files are read for their hashes
  job.note_scene(with_whole_cameras(survey));
  if (options.dry_run) return print_plan(tiling, survey, job);
  check_memory(tiling);
  progress.update("read", 1);

  const auto start = Clock::now();
  const std::vector<TileRecord> records = made_tiles(job, survey, tiling, wanted, *store);
  release_tensor_cache();  // the tiles' memory; what follows needs none of its shape
  OutputFolder& folder = *job.staged;
  const TiledSurface made = write_tiled_surface(
      folder.path(), tiling, records, *store, scene, survey.colour, datum_of(options.geoid),
      wanted.polygons, [&](double share) {
        stop_if_interrupted();
        progress.update("tiles", 1 - kAssembly + kAssembly * share, "putting them together");
      });
  if (!(made.heights.low <= made.heights.high)) refuse_no_heights(options.images);
  SurfaceFacts facts = facts_of(tiling, records, made, scene.frame);
  facts.seconds = seconds_since(start);
  facts.datum = datum_of(options.geoid);
  facts.crs = "EPSG:" + std::to_string(scene.frame.zone.epsg());
  const SurfaceOverview small = overview_of_files(folder.path(), made, tiling.grid.step);
  const reconstruct::Reconstruction overview = overview_of(small, facts, scene);
  job.warnings.add(reconstruct::surface_warnings(overview));
  const std::vector<nn::PosedImage> posed =
      posed_copies(scene, scene.frame.z_from_heights(facts.heights).widened(1));
  const auto agreement = reconstruct::image_agreement(small.dsm, posed);
  facts.image_correlation = agreement.correlation;
  job.warnings.add(reconstruct::image_warnings(agreement, scene.views));
  if (survey.user.pointing) scene::write_pointing(folder / "pointing.json", *survey.user.pointing);
  if (job.crs) job.bring_rasters(geo_grid(tiling.grid, scene.frame), facts);
  progress.update("pictures", 0);
  job.warnings.attempt("pictures",
                       [&] { write_pictures(folder, made, small, scene, posed, progress); });
  progress.update("pictures", 1);
  stop_if_interrupted();
  if (options.mesh == MeshKind::tsdf)
    job.warnings.attempt("mesh", [&] {
      facts.mesh =
          write_mesh(folder / "mesh.ply", small, tiling.grid.step, options.voxel, scene.frame);
    });
  job.record.results() = results_json(facts, survey.user);
  job.record.results()["tile_table"] = table_json(tiling, records, scene.frame);
  if (options.report == ReportKind::html)
    job.warnings.attempt("report", [&] {
      const scene::UserScene whole = with_whole_cameras(survey);
      ReportedSurface surface{
          .made = overview, .user = whole, .views = small.views, .ortho = small.ortho};
      for (const scene::SurveyedView& view : survey.views)
        surface.sizes.push_back({view.width, view.height});
      write_report(folder / "report.html", report_of(surface, job.record));
    });
  job.record.save(folder / "run.json");
  folder.commit();
  // What has failed is tried again by --resume --overwrite.
  if (std::ranges::none_of(records, [](const TileRecord& r) { return r.status == "failed"; }))
    store->remove();
  print_summary(facts, scene, job.record.seconds(), options.out);
  check_coverage(facts.completeness, options);
}

}  // namespace satsurf::app

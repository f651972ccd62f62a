// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/reconstruct_report.h"

#include "satsurf/app/pointing_text.h"
#include "satsurf/core/atomic_file.h"
#include "satsurf/core/memory.h"
#include "satsurf/scene/view_geometry.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

namespace satsurf::app {
namespace {

std::string json_text(const nlohmann::ordered_json& json) {
  return json.dump(2, ' ', false, nlohmann::json::error_handler_t::replace);
}

/// A number of things, for people.
std::string count_text(double n) {
  if (n >= 1e6) return fmt::format("{:.1f} million", n / 1e6);
  return n >= 1e4 ? fmt::format("{:.0f} thousand", n / 1e3) : fmt::format("{:.0f}", n);
}

/// A date as people write it where it begins with eight or fourteen digits; others as they are.
std::string date_text(const std::string& date) {
  const auto digits = static_cast<std::size_t>(
      std::ranges::find_if_not(date, [](char c) { return c >= '0' && c <= '9'; }) - date.begin());
  if (digits != date.size() || (digits != 8 && digits != 14)) return date;
  const std::string day = date.substr(0, 4) + "-" + date.substr(4, 2) + "-" + date.substr(6, 2);
  if (digits == 8) return day;
  return day + " " + date.substr(8, 2) + ":" + date.substr(10, 2) + ":" + date.substr(12, 2);
}

double median_of(const Tensor& values) {
  std::vector<float> known;
  for (const float v : values.values())
    if (std::isfinite(v)) known.push_back(v);
  if (known.empty()) return NAN;
  const auto middle = known.begin() + static_cast<std::ptrdiff_t>(known.size() / 2);
  std::nth_element(known.begin(), middle, known.end());
  return static_cast<double>(*middle);
}

std::vector<std::pair<std::string, std::string>> facts_of(const reconstruct::Reconstruction& made,
                                                          const nlohmann::ordered_json& record) {
  const nlohmann::ordered_json& results = record["results"];
  std::vector<std::pair<std::string, std::string>> facts{
      {fmt::format("{:.1f} to {:.1f} m", results["lowest"].get<double>(),
                   results["highest"].get<double>()),
       "lowest and highest height"},
      {fmt::format("{:.1f} %", 100 * made.completeness), "of the common ground has a height"},
      {fmt::format("{:.2f}", results["mean_confidence"].get<double>()), "mean confidence"},
      {fmt::format("{} images", results["images"].size()), "with their cameras"},
      {count_text(results["surfels"].get<double>()), "surfels"},
      {fmt::format("{:.0f} s", record["wall_seconds"].get<double>()), "time it took"},
      {memory_text(record["peak_memory_bytes"].get<double>()), "of memory at most"}};
  if (!made.sigma.empty())
    facts.insert(facts.begin() + 1,
                 {fmt::format("{:.2f} m", median_of(made.sigma)), "expected error, median"});
  if (const auto datum = results["vertical_datum"].get<std::string>(); datum != "WGS84 ellipsoid")
    facts.emplace_back(datum, "what dsm.tif is above; this page is above the ellipsoid");
  if (const auto crs = results["crs"].get<std::string>(),
      frame = results["frame_crs"].get<std::string>();
      crs != frame)
    facts.emplace_back(crs, "what the rasters are in; this page is in " + frame);
  if (results["mesh"].is_object())
    facts.insert(facts.end() - 2,
                 {count_text(results["mesh"]["faces"].get<double>()), "triangles of the mesh"});
  return facts;
}

ReportImage image_of(const scene::View& view, const std::array<Index, 2>& size,
                     const rpc::UtmZone& zone, double height) {
  const scene::ViewAngles angles = scene::view_angles(view.rpc, size[0], size[1], height);
  ReportImage image{.name = view.name,
                    .date = date_text(view.date),
                    .width = size[0],
                    .height = size[1],
                    .bands = view.bands,
                    .type = view.dtype,
                    .gsd = angles.gsd,
                    .off_nadir_deg = angles.off_nadir_deg,
                    .azimuth_deg = angles.azimuth_deg,
                    .sun_deg = std::nullopt,
                    .footprint = scene::footprint(view.rpc, size[0], size[1], zone, height),
                    .shift = std::nullopt};
  if (view.sun_elevation_deg != 0 || view.sun_azimuth_deg != 0)
    image.sun_deg = {view.sun_elevation_deg, view.sun_azimuth_deg};
  return image;
}

void add_pointing(const scene::Pointing& pointing, Report& report) {
  report.pointing = pointing_line(pointing);
  for (std::size_t i = 0; pointing.applied && i < report.images.size(); ++i)
    report.images[i].shift = pointing.shifts[i];
  for (std::size_t k = 0; k < pointing.before.size(); ++k) {
    const scene::PairResidual& pair = pointing.before[k];
    const bool corrected = pointing.applied && k < pointing.after.size() && pair.ties > 0;
    report.pairs.push_back({pointing.names[pair.a], pointing.names[pair.b], pair.ties, pair.across,
                            corrected ? std::optional(pointing.after[k].across) : std::nullopt,
                            corrected ? pointing.after[k].along : pair.along});
  }
}

/// The numbers of some images on the page.
std::string images_text(const std::vector<std::string>& some,
                        const std::vector<std::string>& names) {
  std::string out;
  for (const std::string& name : some)
    out += (out.empty() ? "" : ", ") +
           std::to_string(std::ranges::find(names, name) - names.begin() + 1);
  return out;
}

/// The tiles of the record.
/// names  of all images, in the order of their numbers on the page
ReportTable tiles_of(const nlohmann::ordered_json& tiles, const std::vector<std::string>& names) {
  ReportTable table;
  table.head = {"Row", "Column", "Status", "With a height", "Searched", "Window", "Images", "Time"};
  for (const auto& tile : tiles) {
    const bool done = tile.contains("window");
    table.rows.push_back(
        {std::to_string(tile["row"].get<Index>()), std::to_string(tile["column"].get<Index>()),
         tile["status"].get<std::string>(),
         fmt::format("{:.1f} %", 100 * tile["completeness"].get<double>()),
         done ? fmt::format("{:.0f} to {:.0f} m", tile["height_range_searched"][0].get<double>(),
                            tile["height_range_searched"][1].get<double>())
              : "",
         done ? fmt::format("{} x {} px", tile["window"][0].get<Index>(),
                            tile["window"][1].get<Index>())
              : "",
         done ? images_text(tile["images"].get<std::vector<std::string>>(), names) : "",
         fmt::format("{:.1f} s", tile["seconds"].get<double>())});
  }
  return table;
}

}  // namespace

Report report_of(const ReportedSurface& surface, const RunRecord& record) {
  const reconstruct::Reconstruction& made = surface.made;
  const scene::UserScene& user = surface.user;
  const scene::Scene& scene = user.scene;
  const nlohmann::ordered_json json = record.json();
  const auto said = [&](const char* key) { return json[key].get<std::string>(); };
  Report report;
  report.title = fmt::format("Surface of {} satellite images", scene.views.size());
  report.program = "satsurf " + said("version") + " (" + said("git") + ")";
  report.made = fmt::format("Made by {}, {}, {} threads, on {}.", report.program, said("isa"),
                            json["threads"].get<int>(), said("started"));
  report.facts = facts_of(made, json);
  report.frame = made.frame;
  report.dsm = made.dsm;
  report.confidence = made.confidence;
  report.sigma = made.sigma;
  report.views = surface.views, report.ortho = surface.ortho;
  if (surface.visibility != nullptr) {
    report.views = surface.visibility->views;
    report.ortho = reconstruct::orthophoto(
        made.dsm, made.images, *surface.visibility,
        [&](Index i) { return scene.views[static_cast<std::size_t>(i)].rgb; });
  }
  const double middle =
      (json["results"]["lowest"].get<double>() + json["results"]["highest"].get<double>()) / 2;
  for (std::size_t i = 0; i < scene.views.size(); ++i) {
    const scene::View& view = scene.views[i];
    report.images.push_back(image_of(
        view, surface.sizes.empty() ? std::array{view.width(), view.height()} : surface.sizes[i],
        made.frame.zone, middle));
  }
  std::vector<std::string> names;
  for (const scene::View& view : scene.views) names.push_back(view.name);
  for (const scene::LeftOut& left : user.left_out)
    report.left_out.emplace_back(left.label, left.why);
  if (user.pointing)
    add_pointing(*user.pointing, report);
  else
    report.pointing = "Not measured: the cameras were taken as they are.";
  for (const auto& warning : json["warnings"])
    report.warnings.push_back(
        {warning["code"].get<std::string>(), warning["text"].get<std::string>()});
  if (json["results"].contains("tile_table"))
    report.tiles = tiles_of(json["results"]["tile_table"], names);
  report.files.head = {"File", "Bytes", "SHA-256"};
  for (const auto& input : json["inputs"])
    report.files.rows.push_back({input["path"].get<std::string>(),
                                 std::to_string(input["bytes"].get<std::uintmax_t>()),
                                 input["sha256"].get<std::string>()});
  report.command = "satsurf reconstruct --config run.json --out again";
  report.settings = json_text(json["config"]);
  return report;
}

void write_report(const std::filesystem::path& file, const Report& report) {
  atomic_write(file, report_html(report));
}

}  // namespace satsurf::app

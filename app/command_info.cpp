// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/info.h"
#include "satsurf/app/interrupt.h"
#include "satsurf/app/log.h"
#include "satsurf/app/pointing_text.h"
#include "satsurf/app/program.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace satsurf::app {
namespace {

struct InfoOptions {
  std::vector<std::filesystem::path> images, image_dirs;
  bool json = false;

  template <class Self, class V>
  static void fields(Self& s, V&& v) {
    v("images", s.images,
      Field{.help = "rasters, Sat-NeRF JSON files or weights",
            .flag = "images",
            .placeholder = "IMG"});
    v("image_dirs", s.image_dirs,
      Field{.help = "where else to look for the images JSON files name",
            .flag = "--image-dir",
            .placeholder = "DIR"});
    v("json", s.json, Field{.help = "print one JSON document instead of text", .flag = "--json"});
  }
};

void print_camera(const ImageFacts& image) {
  const CameraFacts& camera = *image.camera;
  const rpc::Rpc& rpc = *image.info.rpc;
  std::printf("  camera        RPC (%s)\n", image.info.rpc_source.c_str());
  std::printf("  centre        lon %.6f, lat %.6f at %.0f m above the ellipsoid (EPSG:%d)\n",
              camera.centre.lon, camera.centre.lat, camera.height, camera.zone.epsg());
  std::printf("  footprint     %.3f km2:", camera.footprint_km2);
  for (const auto& lon_lat : camera.footprint) std::printf(" (%.6f, %.6f)", lon_lat[0], lon_lat[1]);
  std::printf("\n  pixel         %.3f m across the ray\n", camera.view.gsd);
  std::printf("  seen from     %.1f deg off nadir, azimuth %.1f deg\n", camera.view.off_nadir_deg,
              camera.view.azimuth_deg);
  std::printf("  camera range  %.0f to %.0f m\n", rpc.height_off - std::abs(rpc.height_scale),
              rpc.height_off + std::abs(rpc.height_scale));
}

/// Where the pixels lie by themselves, without a camera.
std::string georeference_text(const rpc::RasterInfo& info) {
  if (!info.crs.empty()) return info.crs;
  if (!info.local_crs.empty())
    return "none: \"" + info.local_crs + "\" is a system of its own, of no place on the Earth";
  return info.geotransform ? "a grid in no known system" : "none";
}

void print_image(const ImageFacts& image) {
  const rpc::RasterInfo& info = image.info;
  std::printf("%s\n", info.path.c_str());
  std::printf("  size          %td x %td px, %td band%s, %s\n", info.width, info.height, info.bands,
              info.bands == 1 ? "" : "s", info.dtype.c_str());
  if (info.nodata) std::printf("  nodata        %g\n", *info.nodata);
  std::printf("  georeference  %s\n", georeference_text(info).c_str());
  if (image.camera) {
    print_camera(image);
  } else {
    std::printf("  camera        none; looked for:");
    for (const std::string& place : info.tried) std::printf(" %s", place.c_str());
    std::printf("\n");
  }
  if (info.height_range)
    std::printf("  ground range  %g to %g m\n", info.height_range->low, info.height_range->high);
  if (info.sun_elevation_deg && info.sun_azimuth_deg)
    std::printf("  sun           %.1f deg high, azimuth %.1f deg\n", *info.sun_elevation_deg,
                *info.sun_azimuth_deg);
  if (info.acquisition_date) std::printf("  date          %s\n", info.acquisition_date->c_str());
  if (!image.damage.empty()) std::printf("  pixels        damaged: %s\n", image.damage.c_str());
}

/// The networks, and what `train` and the averaging of weights have noted of their origin, if they did.
void print_weights(const WeightsFacts& w) {
  std::printf("%s\n", w.file.c_str());
  std::printf("  network       %s\n", w.network.c_str());
  if (!w.surface.empty()) std::printf("  surface       %s\n", w.surface.c_str());
  const auto said = [&](const char* key) {
    const auto at = w.metadata.find(key);
    return at == w.metadata.end() ? std::string("unknown") : at->second;
  };
  if (!w.metadata.contains("train")) {
    std::printf("  training      not told in the file\n");
    return;
  }
  const bool of_surface = said("train").find("\"task\":\"surface\"") != std::string::npos;
  std::printf("  training      %s%s steps on %s scenes, seed %s; %s\n",
              of_surface ? "of the surface network, " : "", said("step").c_str(),
              said("scenes").c_str(), said("seed").c_str(), said("train").c_str());
  std::printf("  program       satsurf %s (%s)\n", said("version").c_str(), said("git").c_str());
  for (const auto& [key, of] : {std::pair("mean_with", "of the network"),
                                std::pair("surface_mean_with", "of the surface network")})
    if (w.metadata.contains(key))
      std::printf("  mean with     %s, another run: %s\n", of, said(key).c_str());
}

/// Overlap in percent of the smaller image, and parallax, for every pair with cameras; how well the
/// cameras agree, and what shifts would make of it.
void print_pairs(const Info& info) {
  const auto file = [&](std::size_t camera) -> const ImageFacts& {
    return info.images[info.cameras[camera]];
  };
  std::printf("pairs\n");
  for (const PairFacts& pair : info.pairs) {
    std::printf("  %s + %s: ", file(pair.a).info.path.filename().c_str(),
                file(pair.b).info.path.filename().c_str());
    if (!pair.unknown.empty())
      std::printf("unknown at %.0f m: %s\n", pair.height, pair.unknown.c_str());
    else if (pair.overlap == 0)
      std::printf("no overlap at %.0f m\n", pair.height);
    else
      std::printf("overlap %.1f %%, parallax %.3f px/m\n", 100 * pair.overlap, pair.parallax);
  }
  std::printf("pointing\n");
  if (!info.pointing.measured) {
    std::printf("  not measured: %s\n", info.pointing.not_measured.c_str());
    return;
  }
  const scene::Pointing& pointing = *info.pointing.measured;
  for (std::size_t k = 0; k < pointing.before.size(); ++k) {
    const scene::PairResidual& pair = pointing.before[k];
    std::printf("  %s + %s: %s", file(pair.a).file.filename().c_str(),
                file(pair.b).file.filename().c_str(), pair_line(pair).c_str());
    if (!pointing.after.empty() && pair.ties > 0)
      std::printf("; with shifts %.2f px across", pointing.after[k].across);
    std::printf("\n");
  }
  std::printf("  correction    %s\n", correction_line(pointing).c_str());
  for (std::size_t i = 0; pointing.applied && i < pointing.shifts.size(); ++i)
    std::printf("  shift         %s: x %.2f, y %.2f px\n", file(i).file.filename().c_str(),
                pointing.shifts[i].x, pointing.shifts[i].y);
}

void run_info(const InfoOptions& options) {
  const Info info = [&] {
    const EndsAtSignal stops;
    return info_of(options.images, options.image_dirs);
  }();
  for (const auto& [file, why] : info.failed) log_line(LogLevel::error, with_flag(why, true));
  for (const ImageFacts& image : info.images)
    if (!image.damage.empty()) log_line(LogLevel::error, image.damage);
  if (options.json) {
    const auto replace = nlohmann::json::error_handler_t::replace;  // of a path that is not UTF-8
    std::printf("%s\n", info_json(info).dump(2, ' ', false, replace).c_str());
  } else {
    for (const ImageFacts& image : info.images) print_image(image);
    if (info.cameras.size() > 1) print_pairs(info);
    for (const WeightsFacts& weights : info.weights) print_weights(weights);
  }
  const bool damaged =
      std::ranges::any_of(info.images, [](const ImageFacts& i) { return !i.damage.empty(); });
  if (damaged || !info.failed.empty()) throw AlreadyTold{};
}

}  // namespace

void add_info(Program& program) {
  Command& command = program.add(
      "info",
      "size, camera, footprint and angles of images; overlap and residuals of pairs; origin of "
      "weights");
  const auto options = std::make_shared<InfoOptions>();
  Flags& flags = command.flags;
  flags.add(collect_fields(*options));
  program.when_called(command, [&flags, options]() -> std::function<void()> {
    flags.read(collect_fields(*options));
    if (options->images.empty()) throw CLI::RequiredError("images");
    return [options] { run_info(*options); };
  });
}

}  // namespace satsurf::app

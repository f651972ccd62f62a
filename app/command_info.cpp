// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/pointing_text.h"
#include "satsurf/app/program.h"
#include "satsurf/core/error.h"
#include "satsurf/core/fields_json.h"
#include "satsurf/core/safetensors.h"
#include "satsurf/nn/weights_file.h"
#include "satsurf/rpc/read.h"
#include "satsurf/scene/pointing.h"
#include "satsurf/scene/view_geometry.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace satsurf::app {
namespace {

struct InfoOptions {
  std::vector<std::filesystem::path> images, image_dirs;

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
  }
};

/// The height at which footprints and angles are told: the middle of the range, or the camera's
/// own.
double reference_height(const rpc::RasterInfo& info) {
  return info.height_range ? info.height_range->middle() : info.rpc->height_off;
}

void print_camera(const rpc::RasterInfo& info) {
  const double h = reference_height(info);
  const rpc::Geodetic c = info.rpc->localize(
      {(static_cast<double>(info.width) - 1) / 2, (static_cast<double>(info.height) - 1) / 2}, h);
  const rpc::UtmZone zone = rpc::utm_zone_of(c.lon, c.lat);
  const scene::Polygon ground = scene::footprint(*info.rpc, info.width, info.height, zone, h);
  const scene::ViewAngles view = scene::view_angles(*info.rpc, info.width, info.height, h);
  std::printf("  camera        RPC (%s)\n", info.rpc_source.c_str());
  std::printf("  centre        lon %.6f, lat %.6f at %.0f m above the ellipsoid (EPSG:%d)\n", c.lon,
              c.lat, h, zone.epsg());
  std::printf("  footprint     %.3f km2:", scene::polygon_area(ground) / 1e6);
  for (const auto& p : ground) {
    const auto lon_lat = rpc::geodetic_from_utm(zone, p[0], p[1]);
    std::printf(" (%.6f, %.6f)", lon_lat[0], lon_lat[1]);
  }
  std::printf("\n  pixel         %.3f m across the ray\n", view.gsd);
  std::printf("  seen from     %.1f deg off nadir, azimuth %.1f deg\n", view.off_nadir_deg,
              view.azimuth_deg);
  std::printf("  camera range  %.0f to %.0f m\n",
              info.rpc->height_off - std::abs(info.rpc->height_scale),
              info.rpc->height_off + std::abs(info.rpc->height_scale));
}

void print_image(const rpc::RasterInfo& info) {
  std::printf("%s\n", info.path.c_str());
  std::printf("  size          %td x %td px, %td band%s, %s\n", info.width, info.height, info.bands,
              info.bands == 1 ? "" : "s", info.dtype.c_str());
  if (info.nodata) std::printf("  nodata        %g\n", *info.nodata);
  if (!info.crs.empty()) std::printf("  georeference  %s\n", info.crs.c_str());
  if (info.rpc) {
    print_camera(info);
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
}

struct Weights {
  std::filesystem::path path;
  std::map<std::string, std::string> metadata;
  std::string network;  ///< its size and configuration, in words
};

/// What a file of weights holds.
/// throws  IoError
Weights weights_in(const std::filesystem::path& path) {
  const TensorFile file = load_safetensors(path);
  const auto said = [](const auto& network) {
    return std::to_string(network.parameters().count()) + " weights; " +
           to_json(network.config()).dump();
  };
  const bool mono = file.metadata.contains("mono") && !file.metadata.contains("model");
  return {path, file.metadata,
          mono ? "monocular, " + said(nn::mono_from(file, path.string()))
               : said(nn::model_from(file, path.string()))};
}

/// The network, and what `train` has noted of its origin, if it did.
void print_weights(const Weights& w) {
  std::printf("%s\n", w.path.c_str());
  std::printf("  network       %s\n", w.network.c_str());
  const auto said = [&](const char* key) {
    const auto at = w.metadata.find(key);
    return at == w.metadata.end() ? std::string("unknown") : at->second;
  };
  if (!w.metadata.contains("train")) {
    std::printf("  training      not told in the file\n");
    return;
  }
  std::printf("  training      %s steps on %s scenes, seed %s; %s\n", said("step").c_str(),
              said("scenes").c_str(), said("seed").c_str(), said("train").c_str());
  std::printf("  program       satsurf %s (%s)\n", said("version").c_str(), said("git").c_str());
}

/// Overlap in percent of the smaller image, and parallax, for every pair with cameras.
void print_pairs(const std::vector<rpc::RasterInfo>& all) {
  std::printf("pairs\n");
  for (std::size_t i = 0; i < all.size(); ++i)
    for (std::size_t j = i + 1; j < all.size(); ++j) {
      const rpc::RasterInfo &a = all[i], &b = all[j];
      std::printf("  %s + %s: ", a.path.filename().c_str(), b.path.filename().c_str());
      const double h = reference_height(a);
      const scene::CommonGround ground =
          scene::common_ground(*a.rpc, a.width, a.height, *b.rpc, b.width, b.height, h);
      if (ground.both.empty()) {
        std::printf("no overlap at %.0f m\n", h);
        continue;
      }
      const auto at = scene::polygon_centroid(ground.both);
      const auto lon_lat = rpc::geodetic_from_utm(ground.zone, at[0], at[1]);
      std::printf("overlap %.1f %%, parallax %.3f px/m\n", 100 * ground.share,
                  scene::parallax(*a.rpc, *b.rpc, {lon_lat[0], lon_lat[1], h}));
    }
}

/// How well the cameras agree, pair by pair, and what shifts would make of it.
void print_pointing(const std::vector<std::filesystem::path>& files, const InfoOptions& options) {
  constexpr double kMostPixels = 1e8;  // of all images together, which are read whole
  std::vector<scene::View> views;
  std::optional<rpc::HeightRange> heights;
  double pixels = 0;
  std::printf("pointing\n");
  for (const auto& file : files) {
    const rpc::RasterInfo info = rpc::view_info(file, options.image_dirs);
    pixels += static_cast<double>(info.width) * static_cast<double>(info.height);
    const double off = info.rpc->height_off, scale = std::abs(info.rpc->height_scale);
    const rpc::HeightRange range =
        info.height_range.value_or(rpc::HeightRange{off - scale, off + scale});
    heights = heights ? rpc::HeightRange{std::min(heights->low, range.low),
                                         std::max(heights->high, range.high)}
                      : range;
  }
  if (pixels > kMostPixels) {
    std::printf("  not measured: %.0f million pixels, expected no more than %.0f\n", pixels / 1e6,
                kMostPixels / 1e6);
    return;
  }
  scene::Pointing pointing;
  try {
    for (const auto& file : files)
      views.push_back(scene::view_of(rpc::open_view(file, options.image_dirs), file));
    pointing = scene::measure_pointing(views, *heights);
  } catch (const Error& e) {  // pixels that cannot be read do not make what files say less true
    std::printf("  not measured: %s\n", e.what());
    return;
  }
  for (std::size_t k = 0; k < pointing.before.size(); ++k) {
    const scene::PairResidual& pair = pointing.before[k];
    std::printf("  %s + %s: %s", views[pair.a].file.filename().c_str(),
                views[pair.b].file.filename().c_str(), pair_line(pair).c_str());
    if (!pointing.after.empty() && pair.ties > 0)
      std::printf("; with shifts %.2f px across", pointing.after[k].across);
    std::printf("\n");
  }
  std::printf("  correction    %s\n", pointing.verdict.c_str());
  if (pointing.applied)
    for (std::size_t i = 0; i < views.size(); ++i)
      std::printf("  shift         %s: x %.2f, y %.2f px\n", views[i].file.filename().c_str(),
                  pointing.shifts[i].x, pointing.shifts[i].y);
}

void run_info(const InfoOptions& options) {
  std::vector<rpc::RasterInfo> all;
  std::vector<std::filesystem::path> images;
  std::vector<Weights> weights;
  for (const auto& file : options.images)  // all are read before anything is said
    if (file.extension() == ".safetensors") {
      weights.push_back(weights_in(file));
    } else {
      images.push_back(file);
      all.push_back(file.extension() == ".json" ? rpc::view_info(file, options.image_dirs)
                                                : rpc::read_info(file));
    }
  std::vector<rpc::RasterInfo> cameras;
  std::vector<std::filesystem::path> files;  // of those cameras
  for (std::size_t i = 0; i < all.size(); ++i) {
    print_image(all[i]);
    if (!all[i].rpc) continue;
    cameras.push_back(all[i]);
    files.push_back(images[i]);
  }
  if (cameras.size() > 1) {
    print_pairs(cameras);
    print_pointing(files, options);
  }
  for (const Weights& w : weights) print_weights(w);
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
  flags.command().get_option("images")->required();
  program.when_called(command, [&flags, options]() -> std::function<void()> {
    flags.read(collect_fields(*options));
    return [options] { run_info(*options); };
  });
}

}  // namespace satsurf::app

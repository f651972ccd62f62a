// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/info.h"

#include "satsurf/app/pointing_text.h"
#include "satsurf/app/record.h"
#include "satsurf/core/error.h"
#include "satsurf/core/fields_json.h"
#include "satsurf/core/safetensors.h"
#include "satsurf/nn/weights_file.h"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

namespace satsurf::app {
namespace {

namespace fs = std::filesystem;

CameraFacts camera_of(const rpc::RasterInfo& info) {
  CameraFacts camera;
  // the middle of the ground's range, or the camera's own
  camera.height = info.height_range ? info.height_range->middle() : info.rpc->height_off;
  camera.centre = info.rpc->localize(
      {(static_cast<double>(info.width) - 1) / 2, (static_cast<double>(info.height) - 1) / 2},
      camera.height);
  camera.zone = rpc::utm_zone_of(camera.centre.lon, camera.centre.lat);
  const scene::Polygon ground =
      scene::footprint(*info.rpc, info.width, info.height, camera.zone, camera.height);
  for (const auto& p : ground)
    camera.footprint.push_back(rpc::geodetic_from_utm(camera.zone, p[0], p[1]));
  camera.footprint_km2 = scene::polygon_area(ground) / 1e6;
  camera.view = scene::view_angles(*info.rpc, info.width, info.height, camera.height);
  return camera;
}

ImageFacts image_of(const fs::path& file, const std::vector<fs::path>& image_dirs) {
  ImageFacts image{file,
                   rpc::names_json(file) ? rpc::view_info(file, image_dirs) : rpc::read_info(file),
                   {},
                   {}};
  if (image.info.rpc) image.camera = camera_of(image.info);
  try {
    rpc::check_pixels(image.info.path);
  } catch (const Error& e) {  // does not make what the file says of itself less true
    image.damage = e.what();
  }
  return image;
}

WeightsFacts weights_of(const fs::path& path) {
  const TensorFile file = load_safetensors(path);
  const auto said = [](const auto& network) {
    return std::to_string(network.parameters().count()) + " weights; " +
           to_json(network.config()).dump();
  };
  const std::optional<nn::SurfaceModel> surface = nn::surface_from(file, path.string());
  const bool mono = file.metadata.contains("mono") && !file.metadata.contains("model");
  return {path, file.metadata,
          mono ? "monocular, " + said(nn::mono_from(file, path.string()))
               : said(nn::model_from(file, path.string())),
          surface ? said(*surface) : std::string()};
}

PairFacts pair_of(const Info& info, std::size_t i, std::size_t j) {
  const ImageFacts &first = info.images[info.cameras[i]], &second = info.images[info.cameras[j]];
  const rpc::RasterInfo &a = first.info, &b = second.info;
  PairFacts pair{i, j, first.camera->height, 0, 0};
  try {
    const scene::CommonGround ground =
        scene::common_ground(*a.rpc, a.width, a.height, *b.rpc, b.width, b.height, pair.height);
    if (ground.both.empty()) return pair;
    const auto at = scene::polygon_centroid(ground.both);
    const auto lon_lat = rpc::geodetic_from_utm(ground.zone, at[0], at[1]);
    pair.parallax = scene::parallax(*a.rpc, *b.rpc, {lon_lat[0], lon_lat[1], pair.height});
    pair.overlap = ground.share;
  } catch (const Error& e) {  // a camera for heights far from the other's
    pair.unknown = e.what();
  }
  return pair;
}

PointingFacts pointing_of(const Info& info, const std::vector<fs::path>& image_dirs) {
  constexpr double kMostPixels = 1e8;  // of all images together, which are read whole
  std::optional<rpc::HeightRange> heights;
  double pixels = 0;
  for (const std::size_t i : info.cameras) {
    const rpc::RasterInfo& image = info.images[i].info;
    pixels += static_cast<double>(image.width) * static_cast<double>(image.height);
    const double off = image.rpc->height_off, scale = std::abs(image.rpc->height_scale);
    const rpc::HeightRange range =
        image.height_range.value_or(rpc::HeightRange{off - scale, off + scale});
    heights = heights ? hull(*heights, range) : range;
  }
  if (pixels > kMostPixels)
    return {{},
            fmt::format("{:.0f} million pixels, expected no more than {:.0f}", pixels / 1e6,
                        kMostPixels / 1e6)};
  try {
    std::vector<scene::View> views;
    for (const std::size_t i : info.cameras) {
      const fs::path& file = info.images[i].file;
      views.push_back(scene::view_of(rpc::open_view(file, image_dirs), file));
    }
    return {scene::measure_pointing(views, *heights), {}};
  } catch (const Error& e) {  // what files say of themselves stays true
    return {{}, e.what()};
  }
}

nlohmann::ordered_json camera_json(const ImageFacts& image) {
  const CameraFacts& camera = *image.camera;
  const rpc::Rpc& rpc = *image.info.rpc;
  const double scale = std::abs(rpc.height_scale);
  return {{"source", image.info.rpc_source},
          {"height", camera.height},
          {"centre", {camera.centre.lon, camera.centre.lat}},
          {"crs", "EPSG:" + std::to_string(camera.zone.epsg())},
          {"footprint", camera.footprint},
          {"footprint_km2", camera.footprint_km2},
          {"pixel", camera.view.gsd},
          {"off_nadir_deg", camera.view.off_nadir_deg},
          {"azimuth_deg", camera.view.azimuth_deg},
          {"height_range", {rpc.height_off - scale, rpc.height_off + scale}}};
}

nlohmann::ordered_json image_json(const ImageFacts& image) {
  const rpc::RasterInfo& info = image.info;
  nlohmann::ordered_json json{{"path", image.file.string()}, {"kind", "image"},
                              {"width", info.width},         {"height", info.height},
                              {"bands", info.bands},         {"type", info.dtype}};
  if (info.nodata) json["nodata"] = json_number(*info.nodata);
  if (!info.crs.empty()) json["crs"] = info.crs;
  json["camera"] = image.camera ? camera_json(image) : nlohmann::ordered_json();
  if (!image.camera) json["camera_looked_for"] = info.tried;
  if (info.height_range) json["ground_range"] = {info.height_range->low, info.height_range->high};
  if (info.sun_elevation_deg && info.sun_azimuth_deg)
    json["sun"] = {{"elevation_deg", *info.sun_elevation_deg},
                   {"azimuth_deg", *info.sun_azimuth_deg}};
  if (info.acquisition_date) json["date"] = *info.acquisition_date;
  if (!image.damage.empty()) json["error"] = image.damage;
  return json;
}

}  // namespace

Info info_of(const std::vector<fs::path>& files, const std::vector<fs::path>& image_dirs) {
  Info info;
  for (const fs::path& file : files) {
    try {
      if (file.extension() == ".safetensors")
        info.weights.push_back(weights_of(file));
      else
        info.images.push_back(image_of(file, image_dirs));
    } catch (const Error& e) {
      info.failed.emplace_back(file, e.what());
    }
  }
  for (std::size_t i = 0; i < info.images.size(); ++i)
    if (info.images[i].camera && info.images[i].damage.empty()) info.cameras.push_back(i);
  for (std::size_t i = 0; i < info.cameras.size(); ++i)
    for (std::size_t j = i + 1; j < info.cameras.size(); ++j)
      info.pairs.push_back(pair_of(info, i, j));
  if (info.cameras.size() > 1) info.pointing = pointing_of(info, image_dirs);
  return info;
}

nlohmann::ordered_json info_json(const Info& info) {
  nlohmann::ordered_json json{{"files", nlohmann::ordered_json::array()}};
  for (const ImageFacts& image : info.images) json["files"].push_back(image_json(image));
  for (const WeightsFacts& weights : info.weights)
    json["files"].push_back({{"path", weights.file.string()},
                             {"kind", "weights"},
                             {"network", weights.network},
                             {"surface_network", weights.surface},
                             {"metadata", weights.metadata}});
  for (const auto& [file, why] : info.failed)
    json["files"].push_back({{"path", file.string()}, {"kind", "unreadable"}, {"error", why}});
  if (info.cameras.size() < 2) return json;
  const auto name = [&](std::size_t camera) {
    return info.images[info.cameras[camera]].file.string();
  };
  json["pairs"] = nlohmann::ordered_json::array();
  for (const PairFacts& pair : info.pairs) {
    nlohmann::ordered_json facts{{"a", name(pair.a)},
                                 {"b", name(pair.b)},
                                 {"overlap", pair.overlap},
                                 {"parallax_px_per_m", pair.parallax}};
    if (!pair.unknown.empty()) facts["unknown"] = pair.unknown;
    json["pairs"].push_back(std::move(facts));
  }
  if (!info.pointing.measured) {
    json["pointing"] = {{"not_measured", info.pointing.not_measured}};
    return json;
  }
  const scene::Pointing& pointing = *info.pointing.measured;
  json["pointing"] = pointing_json(pointing);
  json["pointing"]["verdict"] = correction_line(pointing);
  for (std::size_t k = 0; k < pointing.before.size(); ++k) {
    const scene::PairResidual& before = pointing.before[k];
    nlohmann::ordered_json pair{
        {"a", name(before.a)}, {"b", name(before.b)}, {"ties", before.ties}, {"across", nullptr}};
    if (before.ties > 0) pair["across"] = before.across;
    if (before.along) pair["along"] = *before.along;
    if (k < pointing.after.size() && before.ties > 0)
      pair["across_after"] = pointing.after[k].across;
    json["pointing"]["pairs"].push_back(std::move(pair));
  }
  for (std::size_t i = 0; i < pointing.shifts.size(); ++i)
    json["pointing"]["shifts"].push_back(
        {{"path", name(i)}, {"x", pointing.shifts[i].x}, {"y", pointing.shifts[i].y}});
  return json;
}

}  // namespace satsurf::app

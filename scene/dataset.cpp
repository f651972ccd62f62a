// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/dataset.h"

#include "satsurf/core/files.h"
#include "satsurf/rpc/raster.h"
#include "satsurf/scene/satnerf.h"
#include "satsurf/scene/whu.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <set>
#include <utility>

namespace satsurf::scene {
namespace {

namespace fs = std::filesystem;

/// m added to a DSM's own range: parapets and cells it does not cover
constexpr double kTruthMargin = 5;

[[noreturn]] void no_layout(const fs::path& folder) {
  throw IoError(
      folder.string() +
      ": not a data set, expected Track3-RGB/ and Track3-Truth/ (simulate, DFC2019), images/, "
      "rpcs/ and truth/ (EOGS), image/0/, rpc/0/ and height/0/ (WHU-TLC) or train.txt and the JSON "
      "files it lists (Sat-NeRF), or folders of such");
}

std::vector<fs::path> files_of(const fs::path& folder, const std::vector<std::string>& extensions) {
  std::vector<fs::path> files;
  if (!is_folder(folder)) return files;
  for (const fs::path& entry : entries_of(folder, "images"))
    if (std::find(extensions.begin(), extensions.end(), entry.extension()) != extensions.end())
      files.push_back(entry);
  return files;
}

SceneFiles files_of_scene(const fs::path& folder, const std::string& name) {
  if (const fs::path satnerf = satnerf_folder(folder, name); is_satnerf(satnerf))
    return satnerf_files(satnerf, name);
  const bool track3 = is_folder(folder / "Track3-RGB");
  if (!track3 && !is_folder(folder / "images")) no_layout(folder);
  const fs::path images = track3 ? folder / "Track3-RGB" : folder / "images" / name,
                 truth = track3 ? folder / "Track3-Truth" : folder / "truth" / name;
  SceneFiles files{{}, truth / (name + "_DSM.tif"), truth / (name + "_CLS.tif")};
  for (const fs::path& image : files_of(images, {".tif", ".tiff"})) {
    const std::string stem = image.stem().string();
    if (track3 && scene_of(stem) != name) continue;
    const fs::path json = folder / "rpcs" / name / (stem + ".json");
    if (!track3 && path_exists(json))
      files.views.push_back(rpc::find_view(json, {images}));
    else
      files.views.push_back(rpc::find_view(image));
  }
  if (files.views.empty())
    throw IoError((folder / name).string() + ": no images, expected " + name + "_*_RGB.tif");
  return files;
}

/// A raster of the truth.
/// zone    of one that names no system
/// throws  IoError for one of several bands
rpc::GeoRaster read_one_band(const fs::path& file, const rpc::UtmZone& zone) {
  rpc::GeoRaster raster = rpc::read_geo_raster(file, zone);
  if (raster.values.rank() != 2)
    throw IoError(file.string() + ": " + std::to_string(raster.values.dim(0)) +
                  " bands, expected one");
  return raster;
}

/// The zone in which a surface model lies.
/// throws  IoError for one in another system
rpc::UtmZone zone_of(const fs::path& file, const rpc::GeoRaster& dsm) {
  if (const auto zone = rpc::zone_near_epsg(dsm.grid.epsg)) return *zone;
  throw IoError(file.string() + ": in " +
                (dsm.grid.epsg == 0 ? "a system without a code of EPSG"
                                    : "EPSG:" + std::to_string(dsm.grid.epsg)) +
                ", expected a zone of UTM; warp it first (gdalwarp)");
}

/// Where the middle of a view lies.
/// throws  IoError for a camera that sees it nowhere
rpc::Geodetic centre_of(const View& view) {
  const rpc::Pixel middle{static_cast<double>(view.width()) / 2,
                          static_cast<double>(view.height()) / 2};
  try {
    return view.rpc.localize(middle, view.rpc.height_off);
  } catch (const Error& e) {
    throw IoError(view.label() + ": " + e.what());
  }
}

/// Lowest and highest finite value; NaN if there is none.
std::pair<double, double> finite_range(const Tensor& z) {
  double low = std::nan(""), high = low;
  for (const float v : z.values())
    if (std::isfinite(v)) {
      low = std::isnan(low) ? v : std::min<double>(low, v);
      high = std::isnan(high) ? v : std::max<double>(high, v);
    }
  return {low, high};
}

/// What the files of a scene say, before there is a frame for it.
struct Found {
  std::vector<View> views;
  /// Heights by the views' own files, m above the ellipsoid.
  rpc::HeightRange known{INFINITY, -INFINITY};
  rpc::UtmZone zone;                    ///< the truth's where that names one, else the first view's
  fs::path truth_file;                  ///< or where one was looked for
  std::optional<rpc::GeoRaster> truth;  ///< m above the ellipsoid
  Tensor classes;                       ///< on the truth's cells, or empty
};

/// throws  IoError for a camera that sees the middle of its image nowhere
rpc::UtmZone zone_of(const View& view) {
  const rpc::Geodetic centre = centre_of(view);
  return rpc::utm_zone_of(centre.lon, centre.lat);
}

/// A scene whose truth is a surface model.
Found find_files(const fs::path& folder, const std::string& name) {
  const SceneFiles files = files_of_scene(folder, name);
  Found found;
  for (const rpc::ViewSource& source : files.views) {
    const rpc::Image image = rpc::open_view(source);
    if (image.info.height_range) found.known = hull(found.known, *image.info.height_range);
    found.views.push_back(view_of(image, source.file));
  }
  found.zone = zone_of(found.views[0]);
  found.truth_file = files.dsm.empty() ? folder / (name + "_DSM.tif") : files.dsm;
  if (!path_exists(files.dsm)) return found;
  found.truth = read_one_band(files.dsm, found.zone);
  found.zone = zone_of(files.dsm, *found.truth);
  rpc::require_heights(files.dsm, found.truth->values);
  if (path_exists(files.classes)) {
    const rpc::GeoRaster classes = read_one_band(files.classes, found.zone);
    rpc::require_same_grid(files.classes, classes, files.dsm, *found.truth);
    found.classes = classes.values;
  }
  return found;
}

/// A scene whose truth is the heights of its views.
Found find_whu(const fs::path& folder, const std::string& name) {
  Found found;
  found.views = whu_views(folder, name);
  found.zone = zone_of(found.views[0]);
  WhuTruth truth = whu_truth(folder, name, found.views, found.zone);
  found.truth_file = std::move(truth.file);
  found.truth = std::move(truth.surface);
  return found;
}

}  // namespace

std::vector<std::string> list_scenes(const fs::path& folder) {
  if (!is_folder(folder)) throw IoError(folder.string() + ": no such folder, expected a data set");
  if (is_whu(folder)) {
    const std::set<std::string> names = whu_scenes(folder);
    return {names.begin(), names.end()};
  }
  std::set<std::string> names = satnerf_scenes(folder);
  if (!names.empty()) {
    for (const std::string& name : names) satnerf_views(satnerf_folder(folder, name));
  } else if (is_folder(folder / "Track3-RGB")) {
    for (const fs::path& f : files_of(folder / "Track3-RGB", {".tif", ".tiff"}))
      if (const std::string scene = scene_of(f.stem().string()); !scene.empty())
        names.insert(scene);
  } else if (is_folder(folder / "images")) {
    for (const fs::path& entry : entries_of(folder / "images", "folders of images"))
      if (is_folder(entry)) names.insert(entry.filename().string());
  } else {
    no_layout(folder);
  }
  if (names.empty())
    throw IoError(folder.string() + ": holds no scenes, expected images named SCENE_001_RGB.tif");
  return {names.begin(), names.end()};
}

Scene load_scene(const fs::path& folder, const std::string& name) {
  Found found = is_whu(folder) ? find_whu(folder, name) : find_files(folder, name);
  Scene scene;
  scene.name = name;
  scene.images = folder;
  scene.truth_file = std::move(found.truth_file);
  scene.views = std::move(found.views);
  scene.frame.zone = found.zone;

  rpc::HeightRange known = found.known;
  if (found.truth) {
    const rpc::GeoRaster& raster = *found.truth;
    const auto [z_min, z_max] = finite_range(raster.values);
    if (std::isnan(z_min))
      throw IoError(scene.truth_file.string() + ": no finite height, expected a surface model");
    known = rpc::HeightRange{z_min, z_max}.widened(kTruthMargin);
    const Index H = raster.values.dim(0), W = raster.values.dim(1);
    const double step = raster.grid.step;
    scene.frame.easting0 = std::round(raster.grid.x0 + step * static_cast<double>(W) / 2);
    scene.frame.northing0 = std::round(raster.grid.y0 - step * static_cast<double>(H) / 2);
    scene.frame.h0 = std::round(known.middle());
    HeightField truth{raster.values, raster.grid.x0 - scene.frame.easting0,
                      raster.grid.y0 - scene.frame.northing0, step};
    for (float& z : truth.z.values()) z -= static_cast<float>(scene.frame.h0);
    scene.truth = std::move(truth);
    scene.classes = std::move(found.classes);
  } else {
    const rpc::Geodetic centre = centre_of(scene.views[0]);
    const auto utm = rpc::utm_from_geodetic(scene.frame.zone, centre.lon, centre.lat);
    scene.frame.easting0 = std::round(utm[0]);
    scene.frame.northing0 = std::round(utm[1]);
    if (known.has_span()) scene.frame.h0 = std::round(known.middle());
  }
  if (known.has_span()) scene.z_range = scene.frame.z_from_heights(known);
  return scene;
}

}  // namespace satsurf::scene

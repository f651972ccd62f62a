// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/dataset.h"

#include "satsurf/rpc/raster.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <set>
#include <utility>

namespace satsurf::scene {
namespace {

namespace fs = std::filesystem;

/// m added to a DSM's own range: parapets and cells it does not cover
constexpr double kTruthMargin = 5;

/// One image or JSON file as rpc::open_view takes them.
struct ViewFile {
  fs::path file;
  std::vector<fs::path> image_dirs;
};

/// The files of one scene; those of the truth need not exist.
struct SceneFiles {
  std::vector<ViewFile> views;
  fs::path dsm, classes;
};

[[noreturn]] void no_layout(const fs::path& folder) {
  throw IoError(
      folder.string() +
      ": not a data set, expected Track3-RGB/ and Track3-Truth/ (simulate, DFC2019), images/, "
      "rpcs/ and truth/ (EOGS) or train.txt and the JSON files it lists (Sat-NeRF), or folders of "
      "such");
}

/// JAX_068_012_RGB.tif -> JAX_068; empty if the name has another form.
std::string scene_of(const std::string& stem) {
  if (!stem.ends_with("_RGB")) return {};
  const std::size_t end = stem.rfind('_', stem.size() - 5);
  return end == std::string::npos ? std::string() : stem.substr(0, end);
}

std::vector<fs::path> files_of(const fs::path& folder, const std::vector<std::string>& extensions) {
  std::vector<fs::path> files;
  if (!fs::is_directory(folder)) return files;
  for (const auto& entry : fs::directory_iterator(folder))
    if (std::find(extensions.begin(), extensions.end(), entry.path().extension()) !=
        extensions.end())
      files.push_back(entry.path());
  std::sort(files.begin(), files.end());
  return files;
}

bool is_satnerf(const fs::path& folder) { return fs::is_regular_file(folder / "train.txt"); }

/// A folder's own name, whatever way it is given (".", "a/b/").
std::string name_of(const fs::path& folder) {
  const fs::path p = fs::absolute(folder).lexically_normal();
  return (p.has_filename() ? p : p.parent_path()).filename().string();
}

/// The folder of a Sat-NeRF scene: the data set itself, or one inside it.
fs::path satnerf_folder(const fs::path& folder, const std::string& name) {
  return is_satnerf(folder) && name_of(folder) == name ? folder : folder / name;
}

/// The scenes of a Sat-NeRF data set, by name; none if it is another one.
std::set<std::string> satnerf_scenes(const fs::path& folder) {
  if (is_satnerf(folder)) return {name_of(folder)};
  std::set<std::string> names;
  for (const auto& entry : fs::directory_iterator(folder))
    if (entry.is_directory() && is_satnerf(entry.path()))
      names.insert(entry.path().filename().string());
  return names;
}

/// The JSON files that train.txt and then test.txt list, one a line, each once.
std::vector<fs::path> satnerf_views(const fs::path& folder) {
  std::vector<fs::path> views;
  for (const char* split : {"train.txt", "test.txt"}) {
    const fs::path list = folder / split;
    if (!fs::exists(list)) continue;
    std::ifstream in(list);
    std::string line;
    for (int number = 1; std::getline(in, line); ++number) {
      const std::size_t begin = line.find_first_not_of(" \t\r");
      if (begin == std::string::npos) continue;
      const fs::path view = folder / line.substr(begin, line.find_last_not_of(" \t\r") + 1 - begin);
      if (!fs::is_regular_file(view))
        throw IoError(list.string() + ": line " + std::to_string(number) + " names " +
                      view.filename().string() + ", but there is no " + view.string());
      if (std::find(views.begin(), views.end(), view) == views.end()) views.push_back(view);
    }
    if (views.empty())
      throw IoError(list.string() + ": names no view, expected one JSON file a line");
  }
  return views;
}

/// `folder` and up to three above it: Sat-NeRF's own archive keeps the JSON files in
/// root_dir/SET/SCENE and images and truth in DFC2019 beside root_dir.
std::vector<fs::path> folder_and_above(const fs::path& folder) {
  std::vector<fs::path> folders;
  for (const char* up : {"", "..", "../..", "../../.."}) {
    fs::path p = (folder / up).lexically_normal();
    if (!p.has_filename()) p = p.parent_path();
    if (p.empty()) p = ".";
    if (folders.empty() || p != folders.back()) folders.push_back(p);
  }
  return folders;
}

/// Folders to look in: of every folder those `inside` it that exist ("" is the folder itself), and
/// before each its own sub-folder for one of the scenes.
std::vector<fs::path> places(const std::vector<fs::path>& folders,
                             const std::vector<std::string>& inside,
                             const std::set<std::string>& scenes) {
  std::vector<fs::path> out;
  for (const fs::path& folder : folders)
    for (const std::string& name : inside) {
      const fs::path place = name.empty() ? folder : folder / name;
      if (!fs::is_directory(place)) continue;
      if (!name.empty())
        for (const std::string& scene : scenes)
          if (fs::is_directory(place / scene)) out.push_back(place / scene);
      out.push_back(place);
    }
  return out;
}

/// Views with their images, and the truth, wherever public copies of these data keep them.
SceneFiles satnerf_files(const fs::path& folder, const std::string& name) {
  const std::vector<fs::path> above = folder_and_above(folder);
  SceneFiles files;
  std::set<std::string> scenes{name};  // and the scene its images are named for
  for (const fs::path& json : satnerf_views(folder)) {
    const std::string image = rpc::read_satnerf_json(json).image;
    if (const std::string s = scene_of(fs::path(image).stem().string()); !s.empty())
      scenes.insert(s);
    // crops before the whole images they were cut from, which have the same names
    const std::vector<fs::path> dirs = places(above,
                                              {"", "images", "Track3-RGB-crops", "Track3-RGB",
                                               "DFC2019/Track3-RGB-crops", "DFC2019/Track3-RGB"},
                                              scenes);
    const auto dir = std::find_if(dirs.begin(), dirs.end(),
                                  [&](const fs::path& d) { return fs::exists(d / image); });
    if (dir == dirs.end()) {
      std::string looked;
      for (const fs::path& d : dirs) looked += (looked.empty() ? "" : ", ") + d.string();
      throw IoError(json.string() + ": its image \"" + image + "\" was not found, looked in " +
                    looked + "; put it beside the JSON file, or into images/");
    }
    files.views.push_back({json, {*dir}});
  }
  for (const fs::path& dir :
       places(above, {"", "truth", "Truth", "Track3-Truth", "DFC2019/Track3-Truth"}, scenes))
    for (const std::string& scene : scenes)
      if (files.dsm.empty() && fs::exists(dir / (scene + "_DSM.tif")))
        files.dsm = dir / (scene + "_DSM.tif");
  if (!files.dsm.empty()) {  // classes belong to this grid, so they lie beside it
    const std::string stem = files.dsm.stem().string();
    files.classes = files.dsm.parent_path() / (stem.substr(0, stem.size() - 3) + "CLS.tif");
  }
  return files;
}

SceneFiles files_of_scene(const fs::path& folder, const std::string& name) {
  if (const fs::path satnerf = satnerf_folder(folder, name); is_satnerf(satnerf))
    return satnerf_files(satnerf, name);
  const bool track3 = fs::is_directory(folder / "Track3-RGB");
  if (!track3 && !fs::is_directory(folder / "images")) no_layout(folder);
  const fs::path images = track3 ? folder / "Track3-RGB" : folder / "images" / name,
                 truth = track3 ? folder / "Track3-Truth" : folder / "truth" / name;
  SceneFiles files{{}, truth / (name + "_DSM.tif"), truth / (name + "_CLS.tif")};
  for (const fs::path& image : files_of(images, {".tif", ".tiff"})) {
    const std::string stem = image.stem().string();
    if (track3 && scene_of(stem) != name) continue;
    const fs::path json = folder / "rpcs" / name / (stem + ".json");
    if (!track3 && fs::exists(json))
      files.views.push_back({json, {images}});
    else
      files.views.push_back({image, {}});
  }
  if (files.views.empty())
    throw IoError((folder / name).string() + ": no images, expected " + name + "_*_RGB.tif");
  return files;
}

/// A raster of the truth.
/// throws  IoError for one of several bands
rpc::GeoRaster read_one_band(const fs::path& file, const rpc::UtmZone& zone) {
  rpc::GeoRaster raster = rpc::read_geo_raster(file, zone);
  if (raster.values.rank() != 2)
    throw IoError(file.string() + ": " + std::to_string(raster.values.dim(0)) +
                  " bands, expected one");
  return raster;
}

/// throws  IoError unless the classes lie on the DSM's cells
void check_same_grid(const fs::path& file, const rpc::GeoRaster& classes, const fs::path& dsm_file,
                     const rpc::GeoRaster& dsm) {
  const auto text_of = [](const rpc::GeoRaster& r) {
    char text[160];
    std::snprintf(text, sizeof text, "%td x %td cells of %.10g m from %.10g, %.10g",
                  r.values.dim(1), r.values.dim(0), r.grid.step, r.grid.x0, r.grid.y0);
    return std::string(text);
  };
  const rpc::GeoGrid &a = classes.grid, &b = dsm.grid;
  // files that differ in whether a pixel is an area or a point are half a cell apart
  const double most = 0.6 * b.step,
               cells = static_cast<double>(std::max(dsm.values.dim(0), dsm.values.dim(1)));
  if (classes.values.shape() == dsm.values.shape() && std::abs(a.x0 - b.x0) < most &&
      std::abs(a.y0 - b.y0) < most && std::abs(a.step - b.step) * cells < most)
    return;
  throw IoError(file.string() + ": " + text_of(classes) + ", expected the grid of " +
                dsm_file.string() + ", " + text_of(dsm));
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

}  // namespace

std::vector<std::string> list_scenes(const fs::path& folder) {
  if (!fs::is_directory(folder))
    throw IoError(folder.string() + ": no such folder, expected a data set");
  std::set<std::string> names = satnerf_scenes(folder);
  if (!names.empty()) {
    for (const std::string& name : names) satnerf_views(satnerf_folder(folder, name));
  } else if (fs::is_directory(folder / "Track3-RGB")) {
    for (const fs::path& f : files_of(folder / "Track3-RGB", {".tif", ".tiff"}))
      if (const std::string scene = scene_of(f.stem().string()); !scene.empty())
        names.insert(scene);
  } else if (fs::is_directory(folder / "images")) {
    for (const auto& entry : fs::directory_iterator(folder / "images"))
      if (entry.is_directory()) names.insert(entry.path().filename().string());
  } else {
    no_layout(folder);
  }
  if (names.empty())
    throw IoError(folder.string() + ": holds no scenes, expected images named SCENE_001_RGB.tif");
  return {names.begin(), names.end()};
}

Scene load_scene(const fs::path& folder, const std::string& name) {
  const SceneFiles files = files_of_scene(folder, name);
  Scene scene;
  scene.name = name;
  scene.images = folder;
  scene.truth_file = files.dsm.empty() ? folder / (name + "_DSM.tif") : files.dsm;

  double low = INFINITY, high = -INFINITY;
  for (const ViewFile& file : files.views) {
    const rpc::Image image = rpc::open_view(file.file, file.image_dirs);
    if (image.info.height_range) {
      low = std::min(low, image.info.height_range->low);
      high = std::max(high, image.info.height_range->high);
    }
    scene.views.push_back(view_of(image, file.file));
  }

  const auto centre =
      scene.views[0].rpc.localize({static_cast<double>(scene.views[0].rgb.dim(2)) / 2,
                                   static_cast<double>(scene.views[0].rgb.dim(1)) / 2},
                                  scene.views[0].rpc.height_off);
  scene.frame.zone = rpc::utm_zone_of(centre.lon, centre.lat);

  if (fs::exists(files.dsm)) {
    const rpc::GeoRaster raster = read_one_band(files.dsm, scene.frame.zone);
    const auto [z_min, z_max] = finite_range(raster.values);
    if (std::isnan(z_min))
      throw IoError(files.dsm.string() + ": no finite height, expected a surface model");
    low = z_min - kTruthMargin;
    high = z_max + kTruthMargin;
    const Index H = raster.values.dim(0), W = raster.values.dim(1);
    const double step = raster.grid.step;
    scene.frame.easting0 = std::round(raster.grid.x0 + step * static_cast<double>(W) / 2);
    scene.frame.northing0 = std::round(raster.grid.y0 - step * static_cast<double>(H) / 2);
    scene.frame.h0 = std::round((low + high) / 2);
    HeightField truth{raster.values, raster.grid.x0 - scene.frame.easting0,
                      raster.grid.y0 - scene.frame.northing0, step};
    for (float& z : truth.z.values()) z -= static_cast<float>(scene.frame.h0);
    scene.truth = std::move(truth);
    if (fs::exists(files.classes)) {
      const rpc::GeoRaster c = read_one_band(files.classes, scene.frame.zone);
      check_same_grid(files.classes, c, files.dsm, raster);
      scene.classes = c.values;
    }
  } else {
    const auto utm = rpc::utm_from_geodetic(scene.frame.zone, centre.lon, centre.lat);
    scene.frame.easting0 = std::round(utm[0]);
    scene.frame.northing0 = std::round(utm[1]);
    if (low < high) scene.frame.h0 = std::round((low + high) / 2);
  }
  if (low < high) {
    scene.z_low = low - scene.frame.h0;
    scene.z_high = high - scene.frame.h0;
  }
  return scene;
}

}  // namespace satsurf::scene

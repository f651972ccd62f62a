// SPDX-License-Identifier: Apache-2.0
#include "satsurf/scene/satnerf.h"

#include "satsurf/core/error.h"
#include "satsurf/core/files.h"

#include <algorithm>
#include <sstream>
#include <utility>

namespace satsurf::scene {
namespace {

namespace fs = std::filesystem;

/// A folder's own name, whatever way it is given (".", "a/b/").
std::string name_of(const fs::path& folder) {
  const fs::path p = fs::absolute(folder).lexically_normal();
  return (p.has_filename() ? p : p.parent_path()).filename().string();
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
      if (!is_folder(place)) continue;
      if (!name.empty())
        for (const std::string& scene : scenes)
          if (is_folder(place / scene)) out.push_back(place / scene);
      out.push_back(place);
    }
  return out;
}

}  // namespace

std::string scene_of(const std::string& stem) {
  if (!stem.ends_with("_RGB")) return {};
  const std::size_t end = stem.rfind('_', stem.size() - 5);
  return end == std::string::npos ? std::string() : stem.substr(0, end);
}

bool is_satnerf(const fs::path& folder) { return is_file(folder / "train.txt"); }

fs::path satnerf_folder(const fs::path& folder, const std::string& name) {
  return is_satnerf(folder) && name_of(folder) == name ? folder : folder / name;
}

std::set<std::string> satnerf_scenes(const fs::path& folder) {
  if (is_satnerf(folder)) return {name_of(folder)};
  std::set<std::string> names;
  for (const fs::path& entry : entries_of(folder, "a data set"))
    if (is_satnerf(entry)) names.insert(entry.filename().string());
  return names;
}

std::vector<fs::path> satnerf_views(const fs::path& folder) {
  std::vector<fs::path> views;
  for (const char* split : {"train.txt", "test.txt"}) {
    const fs::path list = folder / split;
    if (!path_exists(list)) continue;
    std::istringstream in(read_text_file(list, "a list of JSON files"));
    std::string line;
    for (int number = 1; std::getline(in, line); ++number) {
      const std::size_t begin = line.find_first_not_of(" \t\r");
      if (begin == std::string::npos) continue;
      const fs::path view = folder / line.substr(begin, line.find_last_not_of(" \t\r") + 1 - begin);
      if (!is_file(view))
        throw IoError(list.string() + ": line " + std::to_string(number) + " names " +
                      view.filename().string() + ", but there is no " + view.string());
      if (std::find(views.begin(), views.end(), view) == views.end()) views.push_back(view);
    }
    if (views.empty())
      throw IoError(list.string() + ": names no view, expected one JSON file a line");
  }
  return views;
}

SceneFiles satnerf_files(const fs::path& folder, const std::string& name) {
  const std::vector<fs::path> above = folder_and_above(folder);
  SceneFiles files;
  std::set<std::string> scenes{name};  // and the scene its images are named for
  for (const fs::path& json : satnerf_views(folder)) {
    rpc::SatNerfJson said = rpc::read_satnerf_json(json);
    const std::string image = said.image;
    if (const std::string s = scene_of(fs::path(image).stem().string()); !s.empty())
      scenes.insert(s);
    // crops before the whole images they were cut from, which have the same names
    const std::vector<fs::path> dirs = places(above,
                                              {"", "images", "Track3-RGB-crops", "Track3-RGB",
                                               "DFC2019/Track3-RGB-crops", "DFC2019/Track3-RGB"},
                                              scenes);
    const auto dir = std::find_if(dirs.begin(), dirs.end(),
                                  [&](const fs::path& d) { return path_exists(d / image); });
    if (dir == dirs.end()) {
      std::string looked;
      for (const fs::path& d : dirs) looked += (looked.empty() ? "" : ", ") + d.string();
      throw IoError(json.string() + ": its image \"" + image + "\" was not found, looked in " +
                    looked + "; put it beside the JSON file, or into images/");
    }
    files.views.push_back({json, *dir / image, std::move(said)});
  }
  for (const fs::path& dir :
       places(above, {"", "truth", "Truth", "Track3-Truth", "DFC2019/Track3-Truth"}, scenes))
    for (const std::string& scene : scenes)
      if (files.dsm.empty() && path_exists(dir / (scene + "_DSM.tif")))
        files.dsm = dir / (scene + "_DSM.tif");
  if (!files.dsm.empty()) {  // classes belong to this grid, so they lie beside it
    const std::string stem = files.dsm.stem().string();
    files.classes = files.dsm.parent_path() / (stem.substr(0, stem.size() - 3) + "CLS.tif");
  }
  return files;
}

}  // namespace satsurf::scene

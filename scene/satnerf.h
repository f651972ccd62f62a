// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/rpc/read.h"

#include <filesystem>
#include <set>
#include <string>
#include <vector>

namespace satsurf::scene {

/// The files of one scene; those of the truth need not exist.
struct SceneFiles {
  std::vector<rpc::ViewSource> views;
  std::filesystem::path dsm, classes;
};

/// JAX_068_012_RGB.tif -> JAX_068; empty if the name has another form.
std::string scene_of(const std::string& stem);

/// Whether a folder is one scene in the layout of Sat-NeRF.
bool is_satnerf(const std::filesystem::path& folder);
/// The folder of a Sat-NeRF scene: the data set itself, or one inside it.
std::filesystem::path satnerf_folder(const std::filesystem::path& folder, const std::string& name);
/// The scenes of a Sat-NeRF data set, by name; none if it is another one.
std::set<std::string> satnerf_scenes(const std::filesystem::path& folder);
/// The JSON files that train.txt and then test.txt list, one a line, each once.
/// throws  IoError
std::vector<std::filesystem::path> satnerf_views(const std::filesystem::path& folder);
/// Views with their images, and the truth, wherever public copies of these data keep them. Every
/// JSON file is read once.
/// throws  IoError
SceneFiles satnerf_files(const std::filesystem::path& folder, const std::string& name);

}  // namespace satsurf::scene

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/scene/scene.h"

#include <filesystem>
#include <string>
#include <vector>

namespace satsurf::scene {

/// The scenes of a data set, sorted by name. `folder` has one of these layouts:
///   simulate, DFC2019 Track 3  Track3-RGB/SCENE_001_RGB.tif ..., Track3-Truth/
///   EOGS                       images/SCENE/, rpcs/SCENE/NAME.json (else RPC tags), truth/SCENE/
///   WHU-TLC ("open_dataset")   image/V/SCENE.png, rpc/V/SCENE.rpc, height/V/SCENE.pfm of the views
///                              V = 0, 1, ..., of which there are two or more
///   Sat-NeRF                   train.txt and test.txt beside the JSON files they list: one scene,
///                              named for the folder; or a folder of such folders
/// throws IoError naming the folder and the layouts, or the line of a split file that names nothing
std::vector<std::string> list_scenes(const std::filesystem::path& folder);

/// Reads one scene: its images, cameras and, where it is found, SCENE_DSM.tif with SCENE_CLS.tif.
/// Views are sorted by name; those of Sat-NeRF come as train.txt and then test.txt list them, their
/// images and truth from the scene's folder or the usual places up to three folders above it.
/// Those of WHU-TLC come in the order of their folders and are called SCENE_0, SCENE_1 and so on. Its
/// truth is made of the heights of that view which looks down most steeply, in cells of the size of
/// its pixels. Heights count up to twice the camera's HEIGHT_SCALE from its HEIGHT_OFF.
/// The frame's zone is the one that the truth names, else that of the first view.
/// The height range is the truth's, or without truth that of the JSON files; it stays 0 to 0 where
/// there is neither.
/// throws IoError naming the file and, for one that is missing, where it was looked for; also for
///        a truth of several bands or in a system that is no zone of UTM on WGS84, and for classes
///        that are not on the DSM's grid
Scene load_scene(const std::filesystem::path& folder, const std::string& name);

}  // namespace satsurf::scene

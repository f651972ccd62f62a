// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/mesh/mesh.h"

#include <filesystem>
#include <functional>
#include <map>
#include <string>

namespace satsurf::mesh {

/// Writes a mesh as binary glTF 2.0, which browsers and 3D programs show: positions, and normals and
/// colours if there are any. glTF is y up: x stays east, north becomes -z, up becomes y. Colours,
/// which are sRGB here, become linear light as the format has it.
/// Source: Khronos, glTF 2.0 specification. Of tinygltf's 8000 lines one function would be used.
/// extras  key = value pairs of the asset, e.g. the frame: programs pass over them
/// poll    called now and then; what it throws ends the writing, without a file
/// throws  IoError, also for a mesh without faces, for numbers that are not finite and faces of
///         vertices there are not
void write_glb(const std::filesystem::path& path, const Mesh& mesh,
               const std::map<std::string, std::string>& extras,
               const std::function<void()>& poll = {});

}  // namespace satsurf::mesh

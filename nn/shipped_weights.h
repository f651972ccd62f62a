// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <string>

// Where the weights were installed: the CMake package defines it for programs that use it.
#ifndef SATSURF_WEIGHTS_FOLDER
#define SATSURF_WEIGHTS_FOLDER ""
#endif

namespace satsurf::nn {

/// A trained network that comes with the library.
enum class ShippedNetwork {
  cascade,  ///< `wide8.safetensors`, for `load_model`; SATSURF_WEIGHTS names another file
  mono      ///< `mono12.safetensors`, for `load_mono`: the branch that training starts from
};

/// The file of its weights: the one that the environment variable SATSURF_WEIGHTS names if it is the
/// cascade, else the one in the first of these folders that has it:
///   share/satsurf of the installation that the running program belongs to, as PREFIX/bin/PROGRAM
///   nn/weights of the sources that it was built in, as build/PRESET/bin/PROGRAM
///   `folder`, by default that of the package with which CMake built the calling program
///   share/satsurf where the library was configured to be installed
/// hint    for the error text: how to name a file
/// throws  IoError naming the folders
std::filesystem::path shipped_weights(ShippedNetwork network = ShippedNetwork::cascade,
                                      const std::string& hint = "set SATSURF_WEIGHTS to a file",
                                      const std::filesystem::path& folder = SATSURF_WEIGHTS_FOLDER);

}  // namespace satsurf::nn

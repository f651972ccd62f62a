// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/safetensors.h"
#include "satsurf/nn/model.h"
#include "satsurf/nn/mono.h"
#include "satsurf/nn/surface_net.h"

#include <filesystem>
#include <map>
#include <optional>
#include <string>

namespace satsurf::nn {

/// A model from a weights or checkpoint file, which carries its configuration.
/// throws  IoError
Model load_model(const std::filesystem::path& path);
/// Writes the model alone, whole or not at all.
/// origin  further metadata: where the weights come from. `train` writes `train` (the configuration
///         of the run, other files by name), `seed`, `step` (those done), `scenes` (trained on),
///         `version` and `git`
/// throws  IoError
void save_model(const std::filesystem::path& path, const Model& model,
                const std::map<std::string, std::string>& origin = {});

/// Before the names of a model's parameters in a file.
constexpr const char* kModelPrefix = "model.";

/// Adds a model to a file that holds more: tensors `model.*`, metadata `format` and `model` (its
/// configuration).
void store_model(TensorFile& file, const Model& model);
/// The model in a file that `store_model` filled; `where` begins the error texts.
/// throws  IoError
Model model_from(const TensorFile& file, const std::string& where);

/// Adds a monocular network to a file that may hold more: tensors `mono.*`, metadata `format` and
/// `mono` (its configuration).
void store_mono(TensorFile& file, const Mono& mono);
/// The monocular network in a file that `store_mono` filled; `where` begins the error texts.
/// throws  IoError
Mono mono_from(const TensorFile& file, const std::string& where);
/// That of a weights or checkpoint file.
/// throws  IoError
Mono load_mono(const std::filesystem::path& path);

/// Before the names of a surface network's parameters in a file.
constexpr const char* kSurfacePrefix = "surface.";
/// Adds a surface network to a file that may hold more: tensors `surface.*`, metadata `format` and
/// `surface` (its configuration).
void store_surface(TensorFile& file, const SurfaceModel& network);
/// The surface network in a file, if it has one; `where` begins the error texts.
/// throws  IoError
std::optional<SurfaceModel> surface_from(const TensorFile& file, const std::string& where);
/// That of a weights or checkpoint file.
/// throws  IoError
std::optional<SurfaceModel> load_surface(const std::filesystem::path& path);

/// Puts a trained monocular network into a model's branch.
/// throws  IoError if the file holds none, or one of another configuration
void load_mono_branch(Model& model, const std::filesystem::path& path);

}  // namespace satsurf::nn

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/weights_file.h"

#include "satsurf/core/error.h"
#include "satsurf/core/fields_json.h"
#include "satsurf/nn/parameter_limit.h"

#include <nlohmann/json.hpp>

namespace satsurf::nn {
namespace {

constexpr const char* kFormat = "satsurf-1";

/// The configuration of a network in a file's metadata.
/// key   of it
/// what  the file should be, for the error text
/// c     what fields that the file does not name are
/// throws  IoError
template <HasFields C>
C config_from(const TensorFile& file, const std::string& key, const std::string& what,
              const std::string& where, C c = {}) {
  const auto format = file.metadata.find("format"), config = file.metadata.find(key);
  if (format == file.metadata.end() || format->second != kFormat || config == file.metadata.end())
    throw IoError(where + ": not a " + what + ", expected metadata format = " + kFormat +
                  " and its configuration");
  try {  // here a wrong configuration is a damaged file, not wrong usage
    from_json(parse_json(config->second, where), c, where);
  } catch (const ConfigError& e) {
    throw IoError(e.what());
  }
  return c;
}

/// Parameters of a network that are worth being made before they are compared one by one with those
/// of the file, which says better what does not fit.
Index most_parameters(const TensorFile& file, const std::string& prefix) {
  constexpr Index kFew = Index{1} << 20;  // made in some milliseconds
  Index held = 0;
  for (const auto& [name, tensor] : file.tensors)
    if (name.starts_with(prefix)) held += tensor.count();
  return kFew + 2 * held;
}

}  // namespace

void store_model(TensorFile& file, const Model& model) {
  file.metadata["format"] = kFormat;
  file.metadata["model"] = to_json(model.config()).dump();
  model.parameters().store(file, kModelPrefix);
}

Model model_from(const TensorFile& file, const std::string& where) {
  // Files from when there was nothing but the cascade name its fields only.
  const auto c = config_from(file, "model", "satsurf model", where, model_preset("cascade8"));
  try {
    Model model = [&] {
      const ParameterLimit limit(most_parameters(file, kModelPrefix), where);
      return Model(c, 0);
    }();
    model.parameters().load(file, kModelPrefix, where);
    return model;
  } catch (const ConfigError& e) {
    throw IoError(where + ": " + e.what());
  }
}

Model load_model(const std::filesystem::path& path) {
  return model_from(load_safetensors(path), path.string());
}

void save_model(const std::filesystem::path& path, const Model& model,
                const std::map<std::string, std::string>& origin) {
  TensorFile file;
  file.metadata = origin;
  store_model(file, model);
  save_safetensors(path, file);
}

void store_mono(TensorFile& file, const Mono& mono) {
  file.metadata["format"] = kFormat;
  file.metadata["mono"] = to_json(mono.config()).dump();
  mono.parameters().store(file, kMonoPrefix);
}

Mono mono_from(const TensorFile& file, const std::string& where) {
  const auto c = config_from<MonoConfig>(file, "mono", "satsurf monocular network", where);
  Mono mono = [&] {
    const ParameterLimit limit(most_parameters(file, kMonoPrefix), where);
    return Mono(c, 0);
  }();
  mono.parameters().load(file, kMonoPrefix, where);
  return mono;
}

Mono load_mono(const std::filesystem::path& path) {
  return mono_from(load_safetensors(path), path.string());
}

void store_surface(TensorFile& file, const SurfaceModel& network) {
  file.metadata["format"] = kFormat;
  file.metadata["surface"] = to_json(network.config()).dump();
  network.parameters().store(file, kSurfacePrefix);
}

std::optional<SurfaceModel> surface_from(const TensorFile& file, const std::string& where) {
  if (!file.metadata.contains("surface")) return std::nullopt;
  const auto c = config_from<SurfaceConfig>(file, "surface", "satsurf surface network", where);
  std::optional<SurfaceModel> network;
  {
    const ParameterLimit limit(most_parameters(file, kSurfacePrefix), where);
    network.emplace(c, 0);
  }
  network->parameters().load(file, kSurfacePrefix, where);
  return network;
}

std::optional<SurfaceModel> load_surface(const std::filesystem::path& path) {
  return surface_from(load_safetensors(path), path.string());
}

void load_mono_branch(Model& model, const std::filesystem::path& path) {
  const Mono mono = load_mono(path);
  if (mono.config() != model.config().mono_net)
    throw IoError(path.string() + ": a monocular network of base " +
                  std::to_string(mono.config().base) + ", expected " +
                  std::to_string(model.config().mono_net.base));
  const std::string prefix = kMonoPrefix;
  for (const auto& from : mono.parameters().entries())
    for (const auto& to : model.parameters().entries())
      if (to.name == prefix + from.name) {
        BasicVar<float> var = to.var;
        var.mutable_value() = from.var.value().clone();
      }
}

}  // namespace satsurf::nn

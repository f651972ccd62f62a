// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/fields_json.h"
#include "satsurf/train/trainer.h"

#include <nlohmann/json.hpp>

namespace satsurf::train {
namespace {

constexpr const char* kFormat = "satsurf-1";
constexpr const char* kPrefix = "model.";

}  // namespace

void store_model(TensorFile& file, const nn::Model& model) {
  file.metadata["format"] = kFormat;
  file.metadata["model"] = to_json(model.config()).dump();
  model.parameters().store(file, kPrefix);
}

nn::Model model_from(const TensorFile& file, const std::string& where) {
  const auto format = file.metadata.find("format"), config = file.metadata.find("model");
  if (format == file.metadata.end() || format->second != kFormat || config == file.metadata.end())
    throw IoError(where + ": not a satsurf model, expected metadata format = " + kFormat +
                  " and its configuration");
  nn::ModelConfig c = nn::model_preset("cascade8");  // all there was when names were fewer
  try {  // here a wrong configuration is a damaged file, not wrong usage
    from_json(parse_json(config->second, where), c, where);
  } catch (const ConfigError& e) {
    throw IoError(e.what());
  }
  try {
    nn::Model model(c, 0);
    model.parameters().load(file, kPrefix, where);
    return model;
  } catch (const ConfigError& e) {
    throw IoError(where + ": " + e.what());
  }
}

nn::Model load_model(const std::filesystem::path& path) {
  return model_from(load_safetensors(path), path.string());
}

void save_model(const std::filesystem::path& path, const nn::Model& model,
                const std::map<std::string, std::string>& origin) {
  TensorFile file;
  file.metadata = origin;
  store_model(file, model);
  save_safetensors(path, file);
}

}  // namespace satsurf::train

// SPDX-License-Identifier: Apache-2.0
// JSON and what is made of it: configurations of every command, records of runs, and the same fields from a command line.
#include "satsurf/app/evaluate_options.h"
#include "satsurf/app/record.h"
#include "satsurf/core/fields_json.h"
#include "satsurf/nn/config.h"
#include "satsurf/nn/surface_net.h"
#include "satsurf/scene/simulate/scene.h"
#include "satsurf/train/mono_trainer.h"
#include "satsurf/train/surface_trainer.h"
#include "satsurf/train/trainer.h"

#include "tests/fuzz/fuzz.h"

namespace satsurf::fuzz {

/// What a configuration takes it gives back.
template <class Config>
void configure(const nlohmann::json& json) {
  only<ConfigError>([&] {
    Config config;
    from_json(json, config, "a.json");
    check_fields(config, "a.json");
    const nlohmann::json saved = to_json(config);
    Config again;
    from_json(parse_json(saved.dump(), "again"), again, "again");
    require(to_json(again) == saved, "a configuration survives its own record");
  });
}

/// `name value`, as a flag has it.
template <class Config>
void set(std::string_view bytes) {
  Bytes in(bytes);
  const std::string name(in.until(' ')), value(in.rest());
  Config config;
  only<ConfigError>([&] { set_field(config, name, value, "satsurf"); });
}

void run(std::string_view bytes) {
  const auto path = folder().put("run.json", bytes);
  app::holds_run(folder().path());
  nlohmann::json json;
  if (!only<ConfigError>([&] { json = app::load_config(path, "reconstruct"); })) {
    set<app::ReconstructConfig>(bytes);
    set<train::TrainConfig>(bytes);
    set<scene::SimulateConfig>(bytes);
    return;
  }
  configure<app::ReconstructConfig>(json);
  configure<app::EvaluateDsmConfig>(json);
  configure<app::EvaluateDataConfig>(json);
  configure<scene::SimulateConfig>(json);
  configure<train::TrainConfig>(json);
  configure<train::MonoTrainConfig>(json);
  configure<train::SurfaceTrainConfig>(json);
  configure<nn::ModelConfig>(json);
  configure<nn::SurfaceConfig>(json);
}

}  // namespace satsurf::fuzz

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

/// The first byte says whose configuration it is; each takes some milliseconds.
void run(std::string_view bytes) {
  Bytes in(bytes);
  const int whose = in.take<std::uint8_t>() % 12;
  if (whose == 9) return set<app::ReconstructConfig>(in.rest());
  if (whose == 10) return set<train::TrainConfig>(in.rest());
  if (whose == 11) return set<scene::SimulateConfig>(in.rest());
  const auto path = folder().put("run.json", in.rest());
  app::holds_run(folder().path());
  nlohmann::json json;
  if (!only<ConfigError>([&] { json = app::load_config(path, "reconstruct"); })) return;
  constexpr void (*kConfigure[])(const nlohmann::json&) = {
      configure<app::ReconstructConfig>,    configure<app::EvaluateDsmConfig>,
      configure<app::EvaluateDataConfig>,   configure<scene::SimulateConfig>,
      configure<train::TrainConfig>,        configure<train::MonoTrainConfig>,
      configure<train::SurfaceTrainConfig>, configure<nn::ModelConfig>,
      configure<nn::SurfaceConfig>};
  kConfigure[whose](json);
}

}  // namespace satsurf::fuzz

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/commands.h"
#include "satsurf/app/output_folder.h"
#include "satsurf/app/progress.h"
#include "satsurf/app/record.h"
#include "satsurf/core/fields_json.h"

#include <algorithm>
#include <cstdio>

#include <nlohmann/json.hpp>

namespace satsurf::app {

void run_simulate(const SimulateOptions& options) {
  scene::SimulateConfig config = options.config;
  scene::check_config(config);
  RunRecord record("simulate", to_json(config), config.seed);
  config.heights = false;  // per-pixel heights are not written
  OutputFolder folder = OutputFolder::staged(options.out, options.overwrite, {options.config_file});
  Progress progress;
  for (Index i = 0; i < config.scenes; ++i) {
    if (interrupted()) throw Interrupted{};
    progress.update("simulate", static_cast<double>(i) / static_cast<double>(config.scenes));
    const scene::SimulatedScene scene = scene::simulate_scene(config, config.seed, i);
    char name[32];
    std::snprintf(name, sizeof name, "SIM_%03td", i + 1);
    scene::write_scene(scene, folder.path(), name);
    double worst = 0;
    for (const scene::SimulatedView& v : scene.views) worst = std::max(worst, v.rpc_max_px);
    record.results()[name] = {{"kind", scene.kind}, {"gsd", scene.gsd}, {"rpc_max_px", worst}};
  }
  progress.update("simulate", 1);
  record.save(folder / "run.json");
  folder.commit();
  std::printf("%td scene%s of %td images written to %s\n", config.scenes,
              config.scenes == 1 ? "" : "s", config.views, options.out.c_str());
}

}  // namespace satsurf::app

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/fields_json.h"
#include "satsurf/train/commands.h"
#include "satsurf/train/output_folder.h"
#include "satsurf/train/progress.h"
#include "satsurf/train/record.h"

#include <algorithm>
#include <cstdio>

#include <nlohmann/json.hpp>

namespace satsurf::train {

void run_simulate(const SimulateOptions& options) {
  SimulateConfig config = options.config;
  check_config(config);
  RunRecord record("simulate", to_json(config), config.seed);
  config.heights = false;  // per-pixel heights are not written
  OutputFolder folder = OutputFolder::staged(options.out, options.overwrite, {options.config_file});
  Progress progress;
  for (Index i = 0; i < config.scenes; ++i) {
    if (interrupted()) throw Interrupted{};
    progress.update("simulate", static_cast<double>(i) / static_cast<double>(config.scenes));
    const SimulatedScene scene = simulate_scene(config, config.seed, i);
    char name[32];
    std::snprintf(name, sizeof name, "SIM_%03td", i + 1);
    write_scene(scene, folder.path(), name);
    double worst = 0;
    for (const SimulatedView& v : scene.views) worst = std::max(worst, v.rpc_max_px);
    record.results()[name] = {{"kind", scene.kind}, {"gsd", scene.gsd}, {"rpc_max_px", worst}};
  }
  progress.update("simulate", 1);
  record.save(folder / "run.json");
  folder.commit();
  std::printf("%td scene%s of %td images written to %s\n", config.scenes,
              config.scenes == 1 ? "" : "s", config.views, options.out.c_str());
}

}  // namespace satsurf::train

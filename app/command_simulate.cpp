// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/interrupt.h"
#include "satsurf/app/output_folder.h"
#include "satsurf/app/program.h"
#include "satsurf/app/progress.h"
#include "satsurf/app/record.h"
#include "satsurf/scene/simulate/scene.h"

#include <algorithm>
#include <cstdio>
#include <memory>
#include <optional>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

namespace satsurf::app {
namespace {

namespace fs = std::filesystem;

struct SimulateOptions {
  scene::SimulateConfig config;
  fs::path out, config_file, surface, classes;
  bool overwrite = false;

  /// Of the options those that are no configuration.
  template <class Self, class V>
  static void fields(Self& s, V&& v) {
    v("out", s.out,
      Field{.help = "folder to make (required unless --print-config)", .placeholder = "DIR"});
    v("surface", s.surface,
      Field{.help = "take the heights from this GeoTIFF, in a zone of UTM, instead of making a "
                    "place up; --relief_max, --tallest_max, --water, --dark and --crags then say "
                    "nothing, --kinds only how many pixels are saturated",
            .placeholder = "DSM"});
    v("classes", s.classes,
      Field{.help = "classes of that surface on the same grid: 2 ground, 5 trees, 6 buildings, "
                    "9 water; without them what is high and rough is a tree",
            .placeholder = "FILE"});
    v("overwrite", s.overwrite,
      Field{.help = "replace what an earlier run left in that folder", .flag = "--overwrite"});
  }
};

void run_simulate(const SimulateOptions& options) {
  scene::SimulateConfig config = options.config;
  scene::check_config(config);
  if (options.surface.empty() && !options.classes.empty())
    throw ConfigError("--classes comes without --surface, expected both or none");
  RunRecord record("simulate", recorded_config(config), config.seed);
  std::optional<scene::GivenSurface> surface;
  std::vector<fs::path> inputs{options.config_file};
  if (!options.surface.empty()) {
    const EndsAtSignal stops;
    surface = scene::read_surface(options.surface, options.classes);
    for (const fs::path& file : {options.surface, options.classes}) {
      if (file.empty()) continue;
      inputs.push_back(file);
      record.add_input(file);
    }
  }
  config.heights = false;  // per-pixel heights are not written
  OutputFolder folder = OutputFolder::staged(options.out, options.overwrite, inputs);
  Progress progress;
  for (Index i = 0; i < config.scenes; ++i) {
    stop_if_interrupted();
    progress.update("simulate", static_cast<double>(i) / static_cast<double>(config.scenes));
    const scene::SimulatedScene scene =
        surface ? scene::simulate_on_surface(*surface, config, config.seed, i)
                : scene::simulate_scene(config, config.seed, i);
    const std::string name = fmt::format("SIM_{:03}", i + 1);
    scene::write_scene(scene, folder.path(), name);
    double worst = 0;
    for (const scene::SimulatedView& v : scene.views) worst = std::max(worst, v.rpc_max_px);
    record.results()[name] = {
        {"kind", enum_name(scene.kind)}, {"gsd", scene.gsd}, {"rpc_max_px", worst}};
  }
  progress.update("simulate", 1);
  record.save(folder / "run.json");
  folder.commit();
  std::printf("%td scene%s of %td images written to %s\n", config.scenes,
              config.scenes == 1 ? "" : "s", config.views, options.out.c_str());
}

}  // namespace

void add_simulate(Program& program) {
  Command& command =
      program.add("simulate", "make up scenes with images, cameras and true surfaces");
  command.files = {
      {"Track3-RGB/NAME_001_RGB.tif", "images, 8 bit, each with its camera in the RPC tag"},
      {"Track3-Truth/NAME_DSM.tif", "the true surface, m above the ellipsoid"},
      {"Track3-Truth/NAME_DSM.txt", "where it lies: east, north, cells a side, cell in m"},
      {"Track3-Truth/NAME_CLS.tif", "its classes: 2 ground, 5 trees, 6 buildings, 9 water"},
      {"Track3-Metadata/NAME.json", "sun, date, angles, height range and zone"},
      {"run.json", "the record of the run"}};
  command.results = {
      {"NAME.kind", "what the scene looks like, see --kinds"},
      {"NAME.gsd", "ground size of a pixel, m"},
      {"NAME.rpc_max_px", "largest error of the RPC against the orbital camera, px"}};
  const auto options = std::make_shared<SimulateOptions>();
  Flags& flags = command.flags;
  flags.add(collect_fields(*options));
  flags.add_config();
  flags.add(collect_fields(options->config), "Configuration");
  program.when_called(command, [&flags, options]() -> std::function<void()> {
    flags.read(collect_fields(*options));
    options->config_file = flags.config_file();
    read_config(flags, options->config);
    if (flags.print_config()) return [options] { print_config(options->config); };
    Flags::require("--out", options->out);
    return [options] { run_simulate(*options); };
  });
}

}  // namespace satsurf::app

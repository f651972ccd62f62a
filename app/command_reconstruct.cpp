// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/program.h"
#include "satsurf/app/reconstruct_job.h"
#include "satsurf/core/memory.h"
#include "satsurf/core/var.h"
#include "satsurf/reconstruct/tiling.h"
#include "satsurf/rpc/read.h"

#include <algorithm>
#include <functional>
#include <memory>
#include <string>

namespace satsurf::app {
namespace {

/// Whether the images are worked on in tiles: because one is too large for the network or for the
/// memory, or because only a part of the ground is wanted.
/// throws  IoError
bool needs_tiles(const ReconstructJob& job) {
  const ReconstructCommand& options = job.options;
  if (options.images.size() < 2) return false;  // which is refused there
  if (!options.bbox.empty() || !options.aoi.empty()) return true;
  Index largest = 0;
  for (const auto& file : options.images) {
    const rpc::RasterInfo info = rpc::view_info(file, options.image_dirs);
    largest = std::max({largest, info.width, info.height});
  }
  if (largest > reconstruct::kWholeImage) return true;
  return !options.max_memory.empty() &&
         largest >
             reconstruct::window_for_memory(
                 job.networks.model.config(),
                 {std::min(static_cast<Index>(options.images.size()), options.max_views), largest,
                  std::min(static_cast<Index>(options.images.size()),
                           std::max(options.max_views, scene::kMostSurveyed))},
                 reconstruct::surface_kind(job.how({})),
                 memory_from_text(options.max_memory, "max_memory"));
}

void run_reconstruct(const ReconstructCommand& options) {
  const NoGrad no_grad;
  ReconstructJob job(options);
  if (needs_tiles(job))
    reconstruct_tiles(job);
  else
    reconstruct_whole(job);
}

}  // namespace

void add_reconstruct(Program& program) {
  Command& command = program.add("reconstruct", "the surface two or more images show");
  command.files = written_by_reconstruct();
  command.results = told_by_reconstruct();
  const auto options = std::make_shared<ReconstructCommand>();
  ReconstructConfig& config = *options;
  Flags& flags = command.flags;
  flags.add(collect_fields(*options));
  flags.add_config();
  flags.add(collect_fields(config), "Configuration");
  program.when_called(command, [&flags, options]() -> std::function<void()> {
    ReconstructConfig& asked = *options;
    flags.read(collect_fields(*options));
    options->config_file = flags.config_file();
    read_config(flags, asked);
    if (flags.print_config())
      return [options] { print_config(static_cast<const ReconstructConfig&>(*options)); };
    if (options->images.empty()) throw CLI::RequiredError("images");
    if (!options->dry_run) Flags::require("--out", options->out);
    if (!asked.bbox.empty() && asked.bbox.size() != 4)
      throw ConfigError("--bbox: " + std::to_string(asked.bbox.size()) +
                        " numbers, expected 4: west,south,east,north");
    if (!asked.bbox.empty() && !asked.aoi.empty())
      throw ConfigError("--bbox and --aoi came, expected one of them");
    return [options] { run_reconstruct(*options); };
  });
}

}  // namespace satsurf::app

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/log.h"
#include "satsurf/app/program.h"
#include "satsurf/app/reconstruct_job.h"
#include "satsurf/core/var.h"
#include "satsurf/reconstruct/tiling.h"
#include "satsurf/rpc/read.h"

#include <algorithm>
#include <filesystem>
#include <functional>
#include <memory>
#include <set>
#include <string>
#include <system_error>
#include <vector>

namespace satsurf::app {
namespace {

/// Whether the images are worked on in tiles, as far as it shows before they are read: because one is
/// too large for the network or for the memory, or because only a part of the ground is wanted.
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
  return job.max_memory > 0 &&
         largest >
             reconstruct::window_for_memory(
                 job.networks.model.config(),
                 {std::min(static_cast<Index>(options.images.size()), options.max_views), largest,
                  std::min(static_cast<Index>(options.images.size()),
                           std::max(options.max_views, scene::kMostSurveyed))},
                 reconstruct::surface_kind(job.how({})), job.max_memory);
}

/// Keeps the first of the names that mean one file: an image beside itself says nothing about heights,
/// and overlapping patterns of a shell may name thousands.
void drop_repeated(std::vector<std::filesystem::path>& images) {
  std::set<std::filesystem::path> seen;
  const std::size_t named = images.size();
  std::erase_if(images, [&](const std::filesystem::path& image) {
    std::error_code unknown;  // what cannot be resolved is told when it is opened
    const auto file = std::filesystem::weakly_canonical(image, unknown);
    return !seen.insert(unknown ? image : file).second;
  });
  if (images.size() < named)
    log_line(LogLevel::info, std::to_string(named - images.size()) + " of " +
                                 std::to_string(named) +
                                 " names of images mean one that came before, and are passed over");
}

void run_reconstruct(ReconstructCommand& options) {
  const NoGrad no_grad;
  drop_repeated(options.images);
  ReconstructJob job(options);
  if (needs_tiles(job) || !reconstruct_whole(job)) reconstruct_tiles(job);
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

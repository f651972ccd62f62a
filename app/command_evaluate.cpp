// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/evaluate_options.h"
#include "satsurf/app/output_folder.h"
#include "satsurf/app/program.h"

#include <algorithm>
#include <memory>
#include <string>
#include <vector>

namespace satsurf::app {
namespace {

namespace fs = std::filesystem;

/// All that may be asked; one of the four is.
struct EvaluateOptions {
  EvaluateOutput output;
  EvaluateDsmCommand dsm;
  EvaluateDataCommand data;
  EvaluateImageConfig image;
  EvaluateMeshConfig mesh;
};

/// One of the things to score.
struct EvaluateMode {
  Mode flags;
  std::function<void()> read;   ///< the configuration
  std::function<void()> print;  ///< it
  std::function<void()> run;
  const fs::path *subject, *partner = nullptr;  ///< files that must be named
  std::string partner_flag{};
};

template <HasFields Config>
EvaluateMode mode_of(const Flags& flags, Config& config, const std::vector<FieldRef>& files) {
  EvaluateMode mode;
  mode.flags.fields = collect_fields(config);
  mode.flags.flag = flag_of(mode.flags.fields.front());
  mode.subject = std::get<fs::path*>(mode.flags.fields.front().target);
  mode.flags.fields.insert(mode.flags.fields.end(), files.begin(), files.end());
  mode.read = [&flags, &config, files] {
    read_config(flags, config);
    flags.read(files);
  };
  mode.print = [&config] { print_config(config); };
  return mode;
}

std::vector<EvaluateMode> modes_of(const Flags& flags, EvaluateOptions& o) {
  EvaluateMode dsm = mode_of<EvaluateDsmConfig>(flags, o.dsm, collect_fields(o.dsm));
  dsm.partner = &o.dsm.truth, dsm.partner_flag = "--truth";
  dsm.run = [&o] { run_evaluate_dsm(o.dsm, o.output); };
  EvaluateMode data = mode_of<EvaluateDataConfig>(flags, o.data, collect_fields(o.data));
  data.run = [&o] { run_evaluate_data(o.data, o.output); };
  EvaluateMode image = mode_of(flags, o.image, {});
  image.partner = &o.image.reference, image.partner_flag = "--reference";
  image.run = [&o] { run_evaluate_image(o.image, o.output); };
  EvaluateMode mesh = mode_of(flags, o.mesh, {});
  mesh.partner = &o.mesh.reference_mesh, mesh.partner_flag = "--reference-mesh";
  mesh.run = [&o] { run_evaluate_mesh(o.mesh, o.output); };
  return {dsm, data, image, mesh};
}

/// The mode that flags or else the file of --config ask for.
const EvaluateMode& chosen(const Flags& flags, const std::vector<EvaluateMode>& modes) {
  auto mode =
      std::ranges::find_if(modes, [&](const EvaluateMode& m) { return flags.given(m.flags.flag); });
  if (const nlohmann::json file = flags.config(); mode == modes.end() && file.is_object())
    mode = std::ranges::find_if(
        modes, [&](const EvaluateMode& m) { return file.contains(m.flags.fields.front().name); });
  if (mode != modes.end()) return *mode;
  throw CLI::RequiredError(
      "--dsm and --truth, --data, --image and --reference, or --mesh and --reference-mesh");
}

/// throws  CLI::RequiredError
void check_subjects(const EvaluateMode& mode) {
  Flags::require(mode.flags.flag, *mode.subject);
  if (mode.partner != nullptr) Flags::require(mode.partner_flag, *mode.partner);
}

std::vector<WrittenFile> written_by_evaluate() {
  return {{"--json", "a record of the run with all numbers, see below"},
          {"--csv", "a row per scene and one of the means, see below"},
          {"--error-map", "picture of the errors on the truth's grid"},
          {"--confidence-csv", "a row per bin of the confidence, see below"},
          {"--confidence-figure", "the same as bar charts, SVG"}};
}

/// The keys of --json; those of a picture and of a mesh stand beside the record's own.
std::vector<WrittenFile> told_by_evaluate() {
  return {
      {"raw, registered", "of --dsm: scores by the numbers below, before and after registration"},
      {"shift_m", "of --dsm: what registration added, east, north, up"},
      {"refused_shift_m",
       "of --dsm: east and north of a shift that correlates best and leaves no smaller errors, so "
       "that it was not added; null without one"},
      {"mean", "of --data: the columns of --csv, each a mean over scenes"},
      {"mean_scenes", "how many scenes a mean is over, where that is fewer than all"},
      {"scenes", "the numbers scene by scene, grouped as in dsm.registered.mae"},
      {"lpips_backbone", "alex, squeeze or vgg; null without --lpips-weights"},
      {"scenes.causes",
       "of --data: the errors by cause, see the columns cause_*; without those that are not known "
       "of a scene"},
      {"confidence.mvs_source, confidence.dsm",
       "pixels, the bins equal_width and equal_count, and monotone: whether the mean error falls "
       "from each bin of the latter kind to the next, of three at least"},
      {"psnr, psnr_infinite, psnr_fitted, ssim, ssim_conv, lpips, lpips_backbone",
       "of --image, beside the keys of the record"},
      {"chamfer, mesh_to_reference, reference_to_mesh, mesh_samples, reference_samples",
       "of --mesh, beside the keys of the record: distances in m, and points they were measured "
       "at"},
      {"f1, precision, recall", "of --mesh: shares by threshold in m: 0.5, 1, 2.5"},
      {"without_walls", "of --mesh: the same without steep parts"}};
}

}  // namespace

void add_evaluate(Program& program) {
  Command& command = program.add("evaluate",
                                 "score a surface against the truth, a network on a data set, or a "
                                 "picture or mesh against another");
  command.files = written_by_evaluate();
  command.results = told_by_evaluate();
  const auto options = std::make_shared<EvaluateOptions>();
  Flags& flags = command.flags;
  const auto modes = std::make_shared<const std::vector<EvaluateMode>>(modes_of(flags, *options));
  flags.add(collect_fields(options->output));
  flags.add_config();
  // an option may be given with whatever stands in the heading it is under
  flags.add((*modes)[0].flags.fields, "One surface");
  flags.add((*modes)[1].flags.fields, "A data set", "One surface or a data set");
  flags.add((*modes)[2].flags.fields, "One picture", "A data set or one picture");
  flags.add((*modes)[3].flags.fields, "One mesh");
  std::vector<Mode> known;
  for (const EvaluateMode& mode : *modes) {
    for (const Mode& other : known)
      flags.command().get_option(mode.flags.flag)->excludes(flags.command().get_option(other.flag));
    known.push_back(mode.flags);
  }
  program.when_called(command, [&flags, options, modes, known]() -> std::function<void()> {
    const EvaluateMode& mode = chosen(flags, *modes);
    refuse_others(flags, known, mode.flags);
    flags.read(collect_fields(options->output));
    mode.read();
    if (flags.print_config()) return mode.print;
    check_subjects(mode);
    return [&flags, options, run = mode.run] {
      check_output_file("--json", options->output.json, true, {flags.config_file()});
      run();
    };
  });
}

}  // namespace satsurf::app

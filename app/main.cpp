// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/commands.h"
#include "satsurf/app/common_flags.h"
#include "satsurf/app/config_flags.h"
#include "satsurf/app/evaluate_flags.h"
#include "satsurf/app/log.h"
#include "satsurf/app/record.h"
#include "satsurf/core/error.h"
#include "satsurf/core/fields_json.h"
#include "satsurf/core/isa.h"
#include "satsurf/core/parallel.h"
#include "satsurf/core/version.h"
#include "satsurf/nn/config.h"

#include <cstdio>
#include <functional>
#include <new>
#include <string>
#include <variant>
#include <vector>

#include <CLI/CLI.hpp>

namespace satsurf::app {
namespace {

enum ExitCode { kDone = 0, kFailed = 1, kUsage = 2, kSignal = 128 };

void complain(const std::string& text) { log_line(LogLevel::error, text); }

template <HasFields S>
void print_config(const S& config) {
  std::printf("%s\n", to_json(config).dump(2).c_str());
}

/// A number within limits; unlike CLI::Range this one refuses NaN.
CLI::Validator number_within(double low, double high) {
  return CLI::Validator(
      [low, high](std::string& text) {
        double x = 0;
        char limits[64];
        std::snprintf(limits, sizeof limits, "%g to %g", low, high);
        const bool good = CLI::detail::lexical_cast(text, x) && x >= low && x <= high;
        return good ? std::string() : text + ", expected a number from " + limits;
      },
      "");
}

void add_info(CLI::App& app, CommonFlags& common, std::function<void()>& run) {
  static InfoOptions o;
  CLI::App* c = add_command(
      app, common, "info",
      "size, camera, footprint and angles of images; overlap of pairs; origin of weights");
  c->add_option("images", o.images, "rasters, Sat-NeRF JSON files or weights")
      ->required()
      ->type_name("IMG");
  c->add_option("--image-dir", o.image_dirs, "where else to look for the images JSON files name")
      ->type_name("DIR");
  c->callback([&] { run = [] { run_info(o); }; });
}

void add_simulate(CLI::App& app, CommonFlags& common, std::function<void()>& run) {
  static SimulateOptions o;
  CLI::App* c =
      add_command(app, common, "simulate", "make up scenes with images, cameras and true surfaces");
  c->add_option("--out", o.out, "folder to make (required unless --print-config)")
      ->type_name("DIR");
  c->add_flag("--overwrite", o.overwrite, "replace what an earlier run left in that folder");
  static ConfigFlags<scene::SimulateConfig> flags(*c, {});
  c->callback([&, c] {
    o.config_file = flags.file();
    o.config = flags.effective(
        {}, "simulate", [](auto&, auto&) {}, [](auto&, auto&) {});
    if (!flags.print() && o.out.empty()) throw CLI::RequiredError("--out");
    run = [] { flags.print() ? print_config(o.config) : run_simulate(o); };
  });
}

/// The network that flags or else the configuration file want trained.
std::string task_of(const CLI::App& command, const std::string& file) {
  if (command.count("--task") > 0) return command.get_option("--task")->as<std::string>();
  if (file.empty()) return "surface";
  const nlohmann::json json = load_config(file);
  const bool told = json.is_object() && json.contains("task") && json["task"].is_string();
  return told ? json["task"].get<std::string>() : "surface";
}

train::TrainConfig surface_config(const ConfigFlags<train::TrainConfig>& flags,
                                  const train::TrainConfig& defaults) {
  const auto apply_preset = [](train::TrainConfig& t) {
    t.model = nn::model_preset(t.preset);
    static_cast<train::LossConfig&>(t) = train::loss_preset(t.preset);
  };
  return flags.effective(
      defaults, "train",
      [&](train::TrainConfig& t,
          const nlohmann::json& json) {  // a file's preset comes before its model fields
        if (!json.is_object() || !json.contains("preset") || !json["preset"].is_string()) return;
        set_field(t, "preset", json["preset"].get<std::string>(), "train");
        apply_preset(t);
      },
      [&](train::TrainConfig& t, const std::string& name) {
        if (name == "preset") apply_preset(t);
      });
}

void add_train(CLI::App& app, CommonFlags& common, std::function<void()>& run) {
  static TrainOptions o;
  CLI::App* c = add_command(app, common, "train", "train a network on scenes with true surfaces");
  c->add_option("--data", o.data,
                "data set: what simulate writes, DFC2019 Track 3, EOGS or Sat-NeRF (required "
                "unless --print-config)")
      ->type_name("DIR");
  c->add_option("--out", o.out,
                "folder for checkpoint, weights and train.jsonl (required unless --print-config)")
      ->type_name("DIR");
  c->add_option("--seed", o.seed, "of the initial weights and the samples")
      ->type_name("N")
      ->capture_default_str();
  CLI::Option* resume =
      c->add_flag("--resume", o.resume,
                  "go on from the checkpoint in --out, with the same configuration; --steps "
                  "included, for the learning rate is planned over all of them");
  c->add_flag("--overwrite", o.overwrite, "replace what an earlier run left in that folder")
      ->excludes(resume);
  train::TrainConfig defaults;
  defaults.model = nn::model_preset(defaults.preset);
  static_cast<train::LossConfig&>(defaults) = train::loss_preset(defaults.preset);
  static ConfigFlags<train::TrainConfig> surface(*c, defaults, "Configuration", "",
                                                 {"init", "mono_weights", "lpips_weights"});
  CLI::Option* preset = c->get_option("--preset");
  preset->description(preset->get_description() + "; see README");
  static ConfigFlags<train::MonoTrainConfig> mono(*c, {}, "--task mono", "task");
  c->callback([&, c, defaults] {
    o.config_file = surface.file();
    if (task_of(*c, surface.file()) == "mono") {
      mono.refuse(surface, "train --task mono");
      o.config = mono.effective(
          {}, "train", [](auto&, auto&) {}, [](auto&, auto&) {});
    } else {
      surface.refuse(mono, "train --task surface");
      o.config = surface_config(surface, defaults);
    }
    if (!surface.print() && o.data.empty()) throw CLI::RequiredError("--data");
    if (!surface.print() && o.out.empty()) throw CLI::RequiredError("--out");
    run = [] {
      surface.print() ? std::visit([](const auto& config) { print_config(config); }, o.config)
                      : run_train(o);
    };
  });
}

void add_reconstruct(CLI::App& app, CommonFlags& common, std::function<void()>& run) {
  static ReconstructCommand o;
  static std::vector<double> range;
  CLI::App* c = add_command(app, common, "reconstruct", "the surface two or more images show");
  c->add_option("images", o.images, "rasters or Sat-NeRF JSON files, two or more")
      ->required()
      ->type_name("IMG");
  c->add_option("--out", o.out, "folder to make (required unless --dry-run)")->type_name("DIR");
  c->add_flag("--overwrite", o.overwrite, "replace what an earlier run left in that folder");
  c->add_flag("--dry-run", o.dry_run,
              "read everything, say ground, cells, tiles and memory, write nothing");
  c->add_option("--image-dir", o.image_dirs, "where else to look for the images JSON files name")
      ->type_name("DIR");
  c->add_option("--weights", o.weights, "network weights [the shipped ones, or SATSURF_WEIGHTS]")
      ->type_name("FILE");
  c->add_option("--height-range", range,
                "heights above the ellipsoid to search [from metadata, else found]")
      ->expected(2)
      ->type_name("number in m")
      ->option_text("LOW HIGH in m")
      ->check(number_within(-12000, 10000));
  c->add_option("--resolution", o.resolution, "cell of the surface [size of a pixel on the ground]")
      ->type_name("number in m")
      ->check(number_within(0.01, 1000));
  static std::string mesh = "tsdf";
  c->add_option("--mesh", mesh, "how to make mesh.ply: tsdf (fused heights of all views), or none")
      ->type_name("HOW")
      ->capture_default_str()
      ->check(CLI::IsMember({"tsdf", "none"}).description(""));
  c->add_option("--voxel", o.voxel, "detail of the mesh [two pixels on the ground]")
      ->type_name("number in m")
      ->check(number_within(0.01, 1000));
  c->callback([&] {
    if (!o.dry_run && o.out.empty()) throw CLI::RequiredError("--out");
    o.mesh = mesh != "none";
    if (range.size() == 2) o.height_range = rpc::HeightRange{range[0], range[1]};
    run = [] { run_reconstruct(o); };
  });
}

void add_render(CLI::App& app, CommonFlags& common, std::function<void()>& run) {
  static RenderCommand o;
  static bool nadir = false;
  CLI::App* c = add_command(app, common, "render",
                            "a reconstructed surface as a camera sees it, or from above");
  c->add_option("--surfels", o.surfels, "surfels.ply of a reconstruction")
      ->required()
      ->type_name("FILE");
  CLI::Option* image =
      c->add_option("--image", o.image, "take the camera and the size of this image")
          ->type_name("IMG");
  CLI::Option* above = c->add_flag("--nadir", nadir, "look straight down")->excludes(image);
  c->add_option("--image-dir", o.image_dirs, "where else to look for the image a JSON file names")
      ->type_name("DIR");
  c->add_option("--resolution", o.resolution, "cell of the view from above")
      ->type_name("number in m")
      ->default_str("0.5")
      ->check(number_within(0.01, 1000));
  c->add_option(
       "--out", o.out,
       "colours as .png; as .tif the colours with the image's camera, or the heights from above")
      ->required()
      ->type_name("FILE");
  c->add_flag("--overwrite", o.overwrite, "replace the file if it exists");
  c->callback([&, image, above] {
    if (image->count() == 0 && above->count() == 0) throw CLI::RequiredError("--image or --nadir");
    run = [] { run_render(o); };
  });
}

/// What ran, for whoever reads the log alone.
void log_command(int argc, char** argv) {
  std::string text = std::string(program_version()) + " (" + program_git_hash() + "), " +
                     isa_name(active_isa()) + ", " + std::to_string(threads()) + " threads:";
  for (int i = 0; i < argc; ++i) text += std::string(" ") + argv[i];
  log_line(LogLevel::debug, text);
}

/// What a user may do about it.
std::string out_of_memory_text(const CLI::App& command) {
  const bool resolution = command.get_option_no_throw("--resolution") != nullptr;
  return std::string("out of memory; try fewer --threads") +
         (resolution ? ", smaller images or a coarser --resolution" : " or smaller images");
}

int run_program(int argc, char** argv) {
  CLI::App app("Georeferenced surfaces from satellite images with RPC cameras", "satsurf");
  app.set_version_flag(
      "--version", std::string("satsurf ") + program_version() + " (" + program_git_hash() + ")");
  app.require_subcommand(1);
  app.get_formatter()->column_width(44);
  app.footer(
      "Exit codes: 0 done, 1 failed, 2 wrong usage, 128 + n stopped by signal n (130: Ctrl-C).");

  CommonFlags common;
  std::function<void()> run;
  add_info(app, common, run);
  add_simulate(app, common, run);
  add_train(app, common, run);
  add_reconstruct(app, common, run);
  add_evaluate(app, common, run);
  add_render(app, common, run);
  std::string names;
  bool known = argc < 2 || argv[1][0] == '-';
  for (const CLI::App* c : app.get_subcommands([](CLI::App*) { return true; })) {
    names += (names.empty() ? "" : ", ") + c->get_name();
    known = known || c->get_name() == argv[1];
  }
  if (!known) {
    complain(std::string("unknown command ") + argv[1] + ", expected one of " + names);
    return kUsage;
  }
  try {
    app.parse(argc, argv);
  } catch (const CLI::Success& e) {
    app.exit(e);  // prints help or version
    return kDone;
  } catch (const CLI::ParseError& e) {
    complain(std::string(e.what()) + "; see satsurf --help");
    return kUsage;
  }
  open_log(common.log_level, common.quiet, common.log_file);
  set_threads(common.threads);
  log_command(argc, argv);
  catch_interrupts();
  try {
    run();
  } catch (const std::bad_alloc&) {
    throw Error(out_of_memory_text(*app.get_subcommands().front()));
  }
  if (std::fflush(stdout) != 0) throw IoError("stdout: cannot be written");
  return kDone;
}

}  // namespace
}  // namespace satsurf::app

int main(int argc, char** argv) {
  using namespace satsurf::app;
  try {
    return run_program(argc, argv);
  } catch (const Interrupted&) {
    complain("stopped");
    return kSignal + interrupt_signal();
  } catch (const satsurf::ConfigError& e) {
    complain(e.what());
    return kUsage;
  } catch (const std::bad_alloc&) {
    complain("out of memory");
    return kFailed;
  } catch (const std::exception& e) {
    complain(e.what());
    return kFailed;
  }
}

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/fields_json.h"
#include "satsurf/core/isa.h"
#include "satsurf/core/parallel.h"
#include "satsurf/nn/config.h"
#include "satsurf/train/commands.h"
#include "satsurf/train/log.h"
#include "satsurf/train/record.h"

#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <functional>
#include <iostream>
#include <new>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include <CLI/CLI.hpp>

namespace satsurf::train {
namespace {

enum ExitCode { kDone = 0, kFailed = 1, kUsage = 2, kSignal = 128 };

void complain(const std::string& text) { log_line(LogLevel::error, text); }

/// Flags for every field of a configuration struct, and the order of precedence: flags, then
/// --config, then defaults. A command may have several structs, of which one is in effect: a flag
/// that two of them know is made once.
template <HasFields S>
class ConfigFlags {
 public:
  /// group     of the flags in the help
  /// selector  the field that says which struct is in effect, if there are several
  ConfigFlags(CLI::App& command, const S& defaults, const std::string& group = "Configuration",
              const std::string& selector = {})
      : command_(command) {
    // a constant text, or CLI11 takes it for the variable to set
    const std::string file_help =
                          "JSON file with any of the fields below, or the run.json of a run",
                      print_help = "print the configuration in effect and stop";
    if (command.get_option_no_throw("--config") == nullptr) {
      command.add_option("--config", file_help)->type_name("FILE");
      command.add_flag("--print-config", print_help);
    }
    for (const FieldInfo& field : describe(defaults)) {
      const std::string name = "--" + field.name;
      names_.push_back(field.name);
      if (CLI::Option* known = command.get_option_no_throw(name)) {
        if (field.name != selector && known->get_default_str() != field.value)
          known->description(known->get_description() + "; " + group + ": " + field.value);
        continue;
      }
      std::string about = field.help;
      if (!field.range.empty()) about += " (" + field.range + ")";
      std::string type = field.type;
      if (!field.unit.empty()) type += " in " + field.unit;
      command.add_option(name, std::as_const(about))
          ->type_name(type)
          ->default_str(field.value)
          ->group(group);
    }
  }

  /// `changed(name)` is told of every flag right after it has been applied.
  S effective(S config, const std::string& where,
              const std::function<void(S&, const nlohmann::json&)>& from_file,
              const std::function<void(S&, const std::string&)>& changed) const {
    if (!file().empty()) {
      const nlohmann::json json = load_config(file());
      from_file(config, json);
      from_json(json, config, file());
    }
    for (const std::string& name : names_) {
      if (!given(name)) continue;
      set_field(config, name, text(name), where);
      changed(config, name);
    }
    return config;
  }
  /// throws  ConfigError if a flag of the other struct alone is there
  template <HasFields Other>
  void refuse(const ConfigFlags<Other>& other, const std::string& where) const {
    for (const std::string& name : other.names())
      if (given(name) && std::ranges::find(names_, name) == names_.end())
        throw ConfigError(where + ": --" + name + " came, which it does not have");
  }
  bool print() const { return given("print-config"); }
  std::string file() const { return given("config") ? text("config") : std::string(); }
  const std::vector<std::string>& names() const { return names_; }

 private:
  bool given(const std::string& name) const { return command_.count("--" + name) > 0; }
  std::string text(const std::string& name) const {
    return command_.get_option("--" + name)->as<std::string>();
  }

  CLI::App& command_;
  std::vector<std::string> names_;
};

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
        return good ? std::string() : text + ", wanted a number from " + limits;
      },
      "");
}

/// What one sub-command needs besides its own options.
struct Common {
  int threads = 0;
  bool quiet = false;
  std::string log_level = "info";
  std::filesystem::path log_file;
};

CLI::App* add_command(CLI::App& app, Common& common, const std::string& name,
                      const std::string& about) {
  CLI::App* command = app.add_subcommand(name, about);
  command->add_option("--threads", common.threads, "most threads to use, 0 for all cores")
      ->type_name("N")
      ->capture_default_str()
      ->check(CLI::Range(0, 4096).description(""));
  command->add_flag("--quiet", common.quiet, "nothing but warnings and errors on stderr");
  command
      ->add_option("--log-level", common.log_level,
                   "what to tell: error, warning, info (progress) or debug (times)")
      ->type_name("LEVEL")
      ->capture_default_str();
  command
      ->add_option("--log-file", common.log_file,
                   "add the messages, each with its time, to the end of this file")
      ->type_name("FILE");
  return command;
}

void add_info(CLI::App& app, Common& common, std::function<void()>& run) {
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

void add_simulate(CLI::App& app, Common& common, std::function<void()>& run) {
  static SimulateOptions o;
  CLI::App* c =
      add_command(app, common, "simulate", "make up scenes with images, cameras and true surfaces");
  c->add_option("--out", o.out, "folder to make")->type_name("DIR");
  c->add_flag("--overwrite", o.overwrite, "replace what an earlier run left in that folder");
  static ConfigFlags<SimulateConfig> flags(*c, {});
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

TrainConfig surface_config(const ConfigFlags<TrainConfig>& flags, const TrainConfig& defaults) {
  const auto apply_preset = [](TrainConfig& t) {
    t.model = nn::model_preset(t.preset);
    static_cast<LossConfig&>(t) = loss_preset(t.preset);
  };
  return flags.effective(
      defaults, "train",
      [&](TrainConfig& t,
          const nlohmann::json& json) {  // a file's preset comes before its model fields
        if (!json.is_object() || !json.contains("preset") || !json["preset"].is_string()) return;
        set_field(t, "preset", json["preset"].get<std::string>(), "train");
        apply_preset(t);
      },
      [&](TrainConfig& t, const std::string& name) {
        if (name == "preset") apply_preset(t);
      });
}

void add_train(CLI::App& app, Common& common, std::function<void()>& run) {
  static TrainOptions o;
  CLI::App* c = add_command(app, common, "train", "train a network on scenes with true surfaces");
  c->add_option("--data", o.data,
                "data set: what simulate writes, DFC2019 Track 3, EOGS or Sat-NeRF")
      ->type_name("DIR");
  c->add_option("--out", o.out, "folder for checkpoint, weights and train.jsonl")->type_name("DIR");
  c->add_option("--seed", o.seed, "of the initial weights and the samples")
      ->type_name("N")
      ->capture_default_str();
  CLI::Option* resume =
      c->add_flag("--resume", o.resume,
                  "go on from the checkpoint in --out, with the same configuration; --steps "
                  "included, for the learning rate is planned over all of them");
  c->add_flag("--overwrite", o.overwrite, "replace what an earlier run left in that folder")
      ->excludes(resume);
  TrainConfig defaults;
  defaults.model = nn::model_preset(defaults.preset);
  static_cast<LossConfig&>(defaults) = loss_preset(defaults.preset);
  static ConfigFlags<TrainConfig> surface(*c, defaults);
  static ConfigFlags<MonoTrainConfig> mono(*c, {}, "--task mono", "task");
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

void add_reconstruct(CLI::App& app, Common& common, std::function<void()>& run) {
  static ReconstructCommand o;
  static std::vector<double> range;
  CLI::App* c = add_command(app, common, "reconstruct", "the surface two or more images show");
  c->add_option("images", o.images, "rasters or Sat-NeRF JSON files, two or more")
      ->required()
      ->type_name("IMG");
  c->add_option("--out", o.out, "folder to make")->type_name("DIR");
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
      ->type_name("LOW HIGH in m")
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

void add_evaluate(CLI::App& app, Common& common, std::function<void()>& run) {
  static EvaluateDsmOptions d;
  static EvaluateDataOptions s;
  static EvaluateImageOptions p;
  static EvaluateMeshOptions m;
  static bool keep_water = false, no_meshes = false;
  CLI::App* c = add_command(app, common, "evaluate",
                            "score one surface, or a network on a data set, against the truth, one "
                            "picture or one mesh against another");
  CLI::Option* dsm =
      c->add_option("--dsm", d.dsm, "surface to score")->type_name("FILE")->group("One surface");
  CLI::Option* truth =
      c->add_option("--truth", d.truth, "true surface")->type_name("FILE")->group("One surface");
  c->add_option("--classes", d.classes, "class raster on the truth's grid")
      ->type_name("FILE")
      ->group("One surface");
  c->add_flag("--mask-water", d.mask_water, "leave cells of class 9 (water) out")
      ->group("One surface");
  c->add_option("--seen-by", d.seen_by, "score only what two or more of these images see")
      ->type_name("IMG")
      ->group("One surface");
  c->add_option("--image-dir", d.image_dirs, "where else to look for the images JSON files name")
      ->type_name("DIR")
      ->group("One surface");
  c->add_option("--error-map", d.picture,
                "picture of the errors, blue too low, red too high, 5 m at most")
      ->type_name("PNG")
      ->group("One surface");
  CLI::Option* data = c->add_option("--data", s.data, "data set: any layout that train takes")
                          ->type_name("DIR")
                          ->group("A data set")
                          ->excludes(dsm);
  c->add_option("--weights", s.weights, "network weights [the shipped ones, or SATSURF_WEIGHTS]")
      ->type_name("FILE")
      ->group("A data set");
  c->add_option("--views", s.views, "source images of each scene")
      ->type_name("N")
      ->capture_default_str()
      ->check(CLI::Range(2, 32).description(""))
      ->group("A data set");
  c->add_flag("--keep-water", keep_water, "score cells of class 9 (water) as well")
      ->group("A data set");
  c->add_flag("--no-meshes", no_meshes,
              "do not fuse meshes for chamfer distance and F1, which takes seconds per scene")
      ->group("A data set");
  c->add_option("--csv", s.csv, "every number, one row per scene and the mean")
      ->type_name("FILE")
      ->group("A data set");
  c->add_option("--confidence-csv", s.confidence_csv,
                "errors by confidence, of source views and DSM, over all scenes")
      ->type_name("FILE")
      ->group("A data set");
  c->add_option("--confidence-figure", s.confidence_figure, "the same as bar charts")
      ->type_name("SVG")
      ->group("A data set");
  CLI::Option* image = c->add_option("--image", p.image,
                                     "picture to score: PNG, JPEG or TIFF; 8-bit values are "
                                     "divided by 255, 16-bit ones by 65535, then all clipped to "
                                     "[0, 1]. Equal pictures: PSNR is infinite, in --json null "
                                     "with psnr_infinite true")
                           ->type_name("FILE")
                           ->group("One picture")
                           ->excludes(dsm)
                           ->excludes(data);
  CLI::Option* reference = c->add_option("--reference", p.reference, "picture it should be")
                               ->type_name("FILE")
                               ->group("One picture");
  c->add_option("--mask", p.mask, "picture of their size, 0 where a pixel does not count")
      ->type_name("FILE")
      ->group("One picture");
  c->add_option("--lpips-weights", p.lpips_weights,
                "LPIPS v0.1 (alex, squeeze or vgg) as safetensors of its state_dict; no LPIPS of "
                "a picture or a data set's rendered views without")
      ->type_name("FILE");
  CLI::Option* mesh = c->add_option("--mesh", m.mesh, "mesh to score: a binary PLY")
                          ->type_name("FILE")
                          ->group("One mesh")
                          ->excludes(dsm)
                          ->excludes(data)
                          ->excludes(image);
  CLI::Option* reference_mesh =
      c->add_option("--reference-mesh", m.reference, "mesh it should be, in the same system")
          ->type_name("FILE")
          ->group("One mesh");
  c->add_option("--register", d.registration, "what is taken out first: none, z or xyz")
      ->type_name("HOW")
      ->capture_default_str();
  c->add_option("--json", d.json, "all numbers and where they came from")->type_name("FILE");
  c->add_flag("--overwrite", d.overwrite, "replace files that exist");
  c->callback([&, dsm, truth, data, image, reference, mesh, reference_mesh] {
    if (mesh->count() > 0) {
      if (reference_mesh->count() == 0) throw CLI::RequiredError("--reference-mesh");
      m.json = d.json, m.overwrite = d.overwrite;
      run = [] { run_evaluate_mesh(m); };
      return;
    }
    if (image->count() > 0) {
      if (reference->count() == 0) throw CLI::RequiredError("--reference");
      p.json = d.json, p.overwrite = d.overwrite;
      run = [] { run_evaluate_image(p); };
      return;
    }
    if (data->count() == 0 && (dsm->count() == 0 || truth->count() == 0))
      throw CLI::RequiredError(
          "--dsm and --truth, --data, --image and --reference, or --mesh and --reference-mesh");
    s.registration = d.registration, s.json = d.json, s.mask_water = !keep_water,
    s.meshes = !no_meshes, s.overwrite = d.overwrite, s.lpips_weights = p.lpips_weights;
    run = [] { s.data.empty() ? run_evaluate_dsm(d) : run_evaluate_data(s); };
  });
}

void add_render(CLI::App& app, Common& common, std::function<void()>& run) {
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

int run_program(int argc, char** argv) {
  CLI::App app("Georeferenced surfaces from satellite images with RPC cameras", "satsurf");
  app.set_version_flag(
      "--version", std::string("satsurf ") + program_version() + " (" + program_git_hash() + ")");
  app.require_subcommand(1);
  app.get_formatter()->column_width(44);
  app.footer(
      "Exit codes: 0 done, 1 failed, 2 wrong usage, 128 + n stopped by signal n (130: Ctrl-C).");

  Common common;
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
    complain(std::string("unknown command ") + argv[1] + ", wanted one of " + names);
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
  run();
  if (std::fflush(stdout) != 0) throw IoError("stdout: cannot be written");
  return kDone;
}

}  // namespace
}  // namespace satsurf::train

int main(int argc, char** argv) {
  using namespace satsurf::train;
  try {
    return run_program(argc, argv);
  } catch (const Interrupted&) {
    complain("stopped");
    return kSignal + interrupt_signal();
  } catch (const satsurf::ConfigError& e) {
    complain(e.what());
    return kUsage;
  } catch (const std::bad_alloc&) {
    complain("out of memory; give --threads fewer, smaller images or a coarser --resolution");
    return kFailed;
  } catch (const std::exception& e) {
    complain(e.what());
    return kFailed;
  }
}

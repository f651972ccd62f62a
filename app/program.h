// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/app/flags.h"
#include "satsurf/app/log.h"

#include <cstdio>
#include <deque>
#include <filesystem>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include <CLI/CLI.hpp>

namespace satsurf::app {

/// What every command takes besides its own flags.
struct CommonFlags {
  int threads = 0;
  bool quiet = false;
  LogLevel log_level = LogLevel::info;
  std::filesystem::path log_file;
  std::vector<std::string> gdal_drivers;

  template <class Self, class V>
  static void fields(Self& s, V&& v) {
    v("threads", s.threads,
      Field{.help = "most threads to use, 0 for all cores", .min = 0, .max = 4096});
    v("quiet", s.quiet,
      Field{.help = "nothing but warnings and errors on stderr", .flag = "--quiet"});
    v("log_level", s.log_level,
      Field{.help = "what to tell, each with those before it; info is progress, debug times",
            .flag = "--log-level"});
    v("log_file", s.log_file,
      Field{.help = "add the messages, each with its time, to the end of this file",
            .flag = "--log-file"});
    v("gdal_drivers", s.gdal_drivers,
      Field{.help = "further drivers of GDAL that may read files, e.g. HDF5: whoever sends a file "
                    "does not choose what reads it",
            .flag = "--gdal-drivers"});
  }
};

/// Something a command writes, a file or a key of one, for the reference.
struct WrittenFile {
  std::string name, meaning;
};

/// A command, as it adds itself to the program.
struct Command {
  Flags flags;
  std::vector<WrittenFile> files{};
  std::vector<WrittenFile> results{};  ///< what `results` of its record hold
};

/// The command line, and what it asked for.
struct Program {
  CLI::App app{"Georeferenced surfaces from satellite images with RPC cameras", "satsurf"};
  CommonFlags common;
  std::deque<Command> commands;
  std::function<void()> run;  ///< what was asked for, once the line is parsed

  /// A command with the common flags.
  Command& add(const std::string& name, const std::string& about) {
    Command& command = commands.emplace_back(Command{Flags(*app.add_subcommand(name, about))});
    command.flags.add(collect_fields(common));
    return command;
  }
  /// The names of the commands.
  std::vector<std::string> names() const {
    std::vector<std::string> out;
    for (const Command& command : commands) out.push_back(command.flags.name());
    return out;
  }
  /// nullptr if there is none of that name.
  const CLI::App* find(const std::string& name) const {
    for (const Command& command : commands)
      if (command.flags.name() == name) return &command.flags.command();
    return nullptr;
  }
  /// Says what to do once the line is parsed.
  /// prepare  reads the command's flags and returns the work
  void when_called(Command& command, std::function<std::function<void()>()> prepare) {
    command.flags.command().callback([this, &command, prepare = std::move(prepare)] {
      command.flags.read(collect_fields(common));
      run = prepare();
    });
  }
};

/// Thrown where all that went wrong has been told: exit code 1 without a further word.
struct AlreadyTold {};

/// A complaint of an image that is nowhere, or of a format that is not trusted, with the flag that
/// mends it: what lies below this room knows no flags. Others come back as they are.
/// image_dirs  whether the command has `--image-dir`
std::string with_flag(std::string text, bool image_dirs);

/// Where the flags of the command that was called are told, to end a complaint.
std::string help_hint(const Program& program);
/// That a command is not known, and which one was meant.
std::string unknown_command(const Program& program, const std::string& name);
/// That arguments of a line were not expected, and what was meant by the first of them.
/// left  what the parser could not place, in order
std::string unexpected_arguments(const Program& program, const std::vector<std::string>& left);

/// That a flag came without its value, or with too few, or a switch with something else than a truth, and
/// what was expected. Other complaints of the parser come back as they are.
/// complaint  the parser's
std::string wrong_value(const Program& program, const std::string& complaint);

/// Prints a configuration as --config takes it.
template <HasFields S>
void print_config(const S& config) {
  std::printf("%s\n", to_json(config).dump(2).c_str());
}

// The commands. Each does its work, writes results to stdout and progress to stderr, and throws
// Error for anything that stops it; files appear complete or not at all.

/// Size, camera and where it came from, footprint, viewing and sun angles of images; overlap and
/// parallax of pairs; network and origin of weights (.safetensors).
void add_info(Program& program);
/// Makes up scenes and writes them in the layout of DFC2019.
void add_simulate(Program& program);
/// Trains a network on a data set. Throws Interrupted after saving a checkpoint.
void add_train(Program& program);
/// Makes a surface of images: the folder that the README describes.
void add_reconstruct(Program& program);
/// Scores a surface, a network, a picture or a mesh.
void add_evaluate(Program& program);
/// Renders a surfel file into a camera or from above.
void add_render(Program& program);
/// Turns results into meshes for browsers and 3D programs: a mesh, a surface or surfels into GLB or PLY.
void add_export(Program& program);
/// Help of the program or a command, and the reference of all.
void add_help(Program& program);

}  // namespace satsurf::app

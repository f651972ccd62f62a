// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/program.h"
#include "satsurf/app/reference.h"
#include "satsurf/core/error.h"

#include <cstdio>
#include <memory>
#include <string>

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace satsurf::app {
namespace {

struct HelpOptions {
  std::string command;
  bool markdown = false;

  template <class Self, class V>
  static void fields(Self& s, V&& v) {
    v("command", s.command,
      Field{.help = "what to help with",
            .automatic = "the program",
            .flag = "command",
            .placeholder = "COMMAND"});
    v("markdown", s.markdown,
      Field{.help = "print the reference of all commands and files, docs/reference.md",
            .flag = "--markdown"});
  }
};

void run_help(const Program& program, const HelpOptions& options) {
  std::string text;
  if (options.markdown) {
    text = reference(program);
  } else if (options.command.empty()) {
    // not App::help, which would tell of this command
    text = program.app.get_formatter()->make_help(&program.app, program.app.get_name(),
                                                  CLI::AppFormatMode::Normal);
  } else {
    const CLI::App* command = program.find(options.command);
    if (command == nullptr)
      throw ConfigError(fmt::format("help: unknown command {}, expected one of {}", options.command,
                                    fmt::join(program.names(), ", ")));
    text = command->help(program.app.get_name());
  }
  std::fputs(text.c_str(), stdout);
}

}  // namespace

void add_help(Program& program) {
  Command& command = program.add("help", "what a command does and takes, as COMMAND --help");
  const auto options = std::make_shared<HelpOptions>();
  command.flags.add(collect_fields(*options));
  program.when_called(command, [&program, &command, options]() -> std::function<void()> {
    command.flags.read(collect_fields(*options));
    return [&program, options] { run_help(program, *options); };
  });
}

}  // namespace satsurf::app

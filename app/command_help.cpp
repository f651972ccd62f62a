// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/completion.h"
#include "satsurf/app/manual.h"
#include "satsurf/app/program.h"
#include "satsurf/app/reference.h"
#include "satsurf/core/error.h"

#include <cstdio>
#include <memory>
#include <string>

namespace satsurf::app {
namespace {

struct HelpOptions {
  std::string command;
  bool markdown = false, man = false;
  std::string completion;

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
    v("man", s.man, Field{.help = "print the manual page, satsurf(1)", .flag = "--man"});
    v("completion", s.completion,
      Field{.help = "print what has a shell complete commands and flags",
            .choices = {"bash"},
            .automatic = "the help"});
  }
};

void run_help(const Program& program, const HelpOptions& options) {
  std::string text;
  if (options.markdown) {
    text = reference(program);
  } else if (options.man) {
    text = man_page(program);
  } else if (!options.completion.empty()) {
    text = bash_completion(program);
  } else if (options.command.empty()) {
    // not App::help, which would tell of this command
    text = program.app.get_formatter()->make_help(&program.app, program.app.get_name(),
                                                  CLI::AppFormatMode::Normal);
  } else {
    const CLI::App* command = program.find(options.command);
    if (command == nullptr) throw ConfigError("help: " + unknown_command(program, options.command));
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

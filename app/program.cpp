// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/program.h"

#include "satsurf/core/nearest.h"

#include <algorithm>

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace satsurf::app {

std::string with_flag(std::string text, bool image_dirs) {
  if (image_dirs && text.ends_with("; name its folder")) text += " with --image-dir";
  constexpr std::string_view kBefore = "; SATSURF_GDAL_DRIVERS=",
                             kBehind = " in the environment allows it";
  if (const std::size_t at = text.rfind(kBefore);
      at != std::string::npos && text.ends_with(kBehind)) {
    text.erase(text.size() - kBehind.size());
    text.replace(at, kBefore.size(), "; --gdal-drivers ");
    text += " allows it";
  }
  return text;
}

std::string help_hint(const Program& program) {
  const std::vector<CLI::App*> called = program.app.get_subcommands();
  return called.empty() ? "; see satsurf --help"
                        : "; see satsurf help " + called.front()->get_name();
}

std::string unknown_command(const Program& program, const std::string& name) {
  const std::vector<std::string> names = program.names();
  const std::optional<std::string> meant = nearest(name, names);
  return fmt::format("unknown command {}, {}expected one of {}", name,
                     meant ? "did you mean " + *meant + "? " : "", fmt::join(names, ", "));
}

std::string unexpected_arguments(const Program& program, const std::vector<std::string>& left) {
  const std::vector<CLI::App*> called = program.app.get_subcommands();
  const std::string command = called.empty() ? std::string() : called.front()->get_name();
  const std::string hint = help_hint(program);
  // what follows a mistyped flag is left over with it
  const auto flag = std::ranges::find_if(
      left, [](const std::string& text) { return text.size() > 1 && text[0] == '-'; });
  if (flag == left.end() || called.empty())
    return fmt::format("{}unexpected {}{}", command.empty() ? "" : command + ": ",
                       fmt::join(left, " "), hint);
  std::vector<std::string> known{"--help"};
  for (const CLI::Option* option : called.front()->get_options()) {
    for (const std::string& name : option->get_lnames()) known.push_back("--" + name);
    for (const std::string& name : option->get_snames()) known.push_back("-" + name);
  }
  const std::string name = flag->substr(0, flag->find('='));
  const std::optional<std::string> meant = nearest(name, known);
  return fmt::format("{}: unknown flag {}{}{}", command, name,
                     meant ? ", did you mean " + *meant + "?" : "", hint);
}

namespace {

/// What a flag takes, in words.
std::string value_text(const Flag& flag) {
  if (!flag.info.type.ends_with("text") || flag.info.range.empty())
    return flag.option->get_type_name();
  std::string words = flag.info.range;
  const bool several = words.find(" | ") != std::string::npos;
  for (std::size_t at; (at = words.find(" | ")) != std::string::npos;) words.replace(at, 3, ", ");
  return (several ? "one of " : "") + words;
}

}  // namespace

std::string wrong_value(const Program& program, const std::string& complaint) {
  const std::vector<CLI::App*> called = program.app.get_subcommands();
  constexpr std::string_view kNoTruth = "Could not convert: ", kCame = " = ";
  if (const std::size_t at = complaint.find(kCame);
      complaint.starts_with(kNoTruth) && at != std::string::npos)
    return fmt::format("{} is '{}', expected true or false",
                       complaint.substr(kNoTruth.size(), at - kNoTruth.size()),
                       complaint.substr(at + kCame.size()));
  const std::size_t end = complaint.find(':');
  if (called.empty() || end == std::string::npos || !complaint.ends_with(" missing"))
    return complaint;
  const std::string spelling = complaint.substr(0, end);
  for (const Command& command : program.commands) {
    if (&command.flags.command() != called.front()) continue;
    for (const Flag& flag : command.flags.all())
      if (flag.option->check_name(spelling))
        return fmt::format("{}: {} came without a value, expected {}", command.flags.name(),
                           spelling, value_text(flag));
  }
  return complaint;
}

}  // namespace satsurf::app

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/manual.h"

#include "satsurf/core/version.h"

#include <cctype>

#include <fmt/format.h>

namespace satsurf::app {
namespace {

/// Text as troff prints it: no backslash, no dash that becomes a hyphen, no line that begins with a
/// command.
std::string troff(const std::string& text) {
  std::string out;
  for (const char c : text)
    out += c == '\\' ? "\\e" : c == '-' ? "\\-" : c == '\n' ? " " : std::string(1, c);
  return out.starts_with('.') || out.starts_with('\'') ? "\\&" + out : out;
}

std::string upper(std::string text) {
  for (char& c : text) c = static_cast<char>(std::toupper(static_cast<unsigned char>(c)));
  return text;
}

/// A flag with all its spellings and what it takes, then what it means.
std::string flag_text(const Flag& flag) {
  const CLI::Option& option = *flag.option;
  std::string spellings = option.get_name(true, true), shown;
  for (const char c : spellings) shown += c == ',' ? std::string(", ") : std::string(1, c);
  std::string out = ".TP\n\\fB" + troff(shown) + "\\fR";
  if (!flag.is_switch && !option.get_type_name().empty())
    out += " \\fI" + troff(option.get_type_name()) + "\\fR";
  out += "\n" + troff(option.get_description());
  if (!flag.is_switch && !option.get_default_str().empty())
    out += " Default: " + troff(option.get_default_str()) + ".";
  return out + "\n";
}

/// What stands on the line without a flag.
std::string arguments_of(const Command& command) {
  std::string out;
  for (const Flag& flag : command.flags.all())
    if (flag.option->get_positional())
      out += "\\fI" + troff(flag.option->get_type_name()) + "\\fR... ";
  return out;
}

}  // namespace

std::string man_page(const Program& program) {
  CommonFlags fresh;
  const std::size_t common = collect_fields(fresh).size();
  std::string out = fmt::format(
      ".TH SATSURF 1 \"\" \"satsurf {}\" \"User Commands\"\n.SH NAME\nsatsurf \\- georeferenced "
      "surfaces from satellite images with RPC cameras\n.SH SYNOPSIS\n",
      program_version());
  for (const Command& command : program.commands)
    out += ".B satsurf " + troff(command.flags.name()) + "\n" + arguments_of(command) +
           "[\\fIoptions\\fR]\n.br\n";
  out +=
      ".SH DESCRIPTION\nTwo or more satellite images with RPC cameras in, a georeferenced surface "
      "out: heights, confidence, Gaussian surfels, a mesh, rendered views and a report.\n";
  for (const Command& command : program.commands) {
    out += ".SH SATSURF " + troff(upper(command.flags.name())) + "\n" +
           troff(command.flags.command().get_description()) + ".\n";
    const std::vector<Flag>& flags = command.flags.all();
    for (std::size_t k = common; k < flags.size(); ++k) out += flag_text(flags[k]);
    if (command.files.empty()) continue;
    out += ".PP\nIt writes\n";
    for (const WrittenFile& file : command.files)
      out += ".TP\n\\fI" + troff(file.name) + "\\fR\n" + troff(file.meaning) + "\n";
  }
  out += ".SH OPTIONS OF EVERY COMMAND\n";
  for (std::size_t k = 0; k < common; ++k)
    out += flag_text(program.commands.front().flags.all()[k]);
  return out +
         ".SH EXIT STATUS\n0 done, 1 failed, 2 wrong usage, 128 + n stopped by signal n.\n"
         ".SH ENVIRONMENT\n.TP\nSATSURF_WEIGHTS\nweights to take where none are named.\n.TP\n"
         "SATSURF_ISA\ninstruction set to use: baseline, avx2 or avx512.\n.TP\n"
         "SATSURF_GDAL_DRIVERS\nfurther drivers of GDAL to trust, separated by commas.\n";
}

}  // namespace satsurf::app

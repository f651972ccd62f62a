// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/completion.h"

#include <algorithm>
#include <vector>

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace satsurf::app {
namespace {

/// Every spelling of a flag with its dashes; none for an argument without.
std::vector<std::string> spellings_of(const Flag& flag) {
  std::vector<std::string> out;
  for (const std::string& name : flag.option->get_snames()) out.push_back("-" + name);
  for (const std::string& name : flag.option->get_lnames()) out.push_back("--" + name);
  return out;
}

/// `l1 | l2` of a choice as words; empty for a range of numbers.
std::string words_of(const std::string& range) {
  std::string out;
  bool choice = false;
  for (const char c : range)
    if (c == '|')
      choice = true;
    else if (c != ' ' || !out.ends_with(' '))
      out += c;
  return choice ? out : std::string();
}

}  // namespace

std::string bash_completion(const Program& program) {
  std::string flags, values;
  for (const Command& command : program.commands) {
    std::vector<std::string> all{"--help"};
    for (const Flag& flag : command.flags.all()) {
      const std::vector<std::string> spellings = spellings_of(flag);
      all.insert(all.end(), spellings.begin(), spellings.end());
      const std::string words = words_of(flag.info.range);
      for (const std::string& spelling : spellings)
        if (!words.empty())
          values += fmt::format("    \"{} {}\") words=\"{}\" ;;\n", command.flags.name(), spelling,
                                words);
    }
    flags += fmt::format("    {}) words=\"{}\" ;;\n", command.flags.name(), fmt::join(all, " "));
  }
  return fmt::format(
      R"(# Completion of satsurf for bash, as `satsurf help --completion bash` prints it.
_satsurf() {{
  local word=${{COMP_WORDS[COMP_CWORD]}} before=${{COMP_WORDS[COMP_CWORD-1]}} command=${{COMP_WORDS[1]}} words=
  COMPREPLY=()
  if [ "$COMP_CWORD" -eq 1 ]; then
    COMPREPLY=($(compgen -W "{} --help --version" -- "$word"))
    return
  fi
  case "$command $before" in
{}    "help "*) words="{}" ;;
  esac
  if [ -z "$words" ] && [[ $word == -* ]]; then
    case "$command" in
{}    esac
  fi
  if [ -n "$words" ]; then
    COMPREPLY=($(compgen -W "$words" -- "$word"))
  else
    COMPREPLY=($(compgen -f -- "$word"))
    compopt -o filenames 2>/dev/null
  fi
}}
complete -F _satsurf satsurf
)",
      fmt::join(program.names(), " "), values, fmt::join(program.names(), " "), flags);
}

}  // namespace satsurf::app

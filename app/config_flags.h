// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/app/record.h"
#include "satsurf/core/error.h"
#include "satsurf/core/fields_json.h"

#include <algorithm>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include <CLI/CLI.hpp>

namespace satsurf::app {

/// Flags for every field of a configuration struct, and the order of precedence: flags, then
/// --config, then defaults. A command may have several structs, of which one is in effect: a flag
/// that two of them know is made once.
template <HasFields S>
class ConfigFlags {
 public:
  /// group     of the flags in the help
  /// selector  the field that says which struct is in effect, if there are several
  /// files     fields that name a file; their flags take dashes as well, as other commands' do
  ConfigFlags(CLI::App& command, const S& defaults, const std::string& group = "Configuration",
              const std::string& selector = {}, const std::vector<std::string>& files = {})
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
      std::string type = field.type, spellings = name;
      if (!field.unit.empty()) type += " in " + field.unit;
      if (std::ranges::find(files, field.name) != files.end()) {
        type = "FILE";
        std::string dashed = name;
        std::ranges::replace(dashed, '_', '-');
        if (dashed != name) spellings += "," + dashed;
      }
      command.add_option(spellings, std::as_const(about))
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

}  // namespace satsurf::app

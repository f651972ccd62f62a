// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/app/record.h"
#include "satsurf/core/fields_json.h"

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>

namespace satsurf::app {

/// A flag as its command has it.
struct Flag {
  CLI::Option* option;
  FieldInfo info;  ///< of the field it sets; of the first one where several structs have it
  bool is_switch;
};

/// The flags of one command, declared by the fields of its structs (core/fields.h). Several structs
/// may have a field of the same flag, which is made once.
class Flags {
 public:
  explicit Flags(CLI::App& command) : command_(command) {}

  /// Makes a flag for every field.
  /// heading   in the help
  /// shared    heading that flags get which are there already; empty to leave them where they are
  void add(const std::vector<FieldRef>& fields, const std::string& heading = "Options",
           const std::string& shared = {});
  /// `--config FILE` and `--print-config`.
  void add_config();

  /// Whether a flag came.
  bool given(const std::string& flag) const { return command_.count(flag) > 0; }
  /// Sets the fields whose flags came, in the order of declaration.
  /// changed  told the name of each field right after it was set; may be empty
  /// throws   ConfigError
  void read(const std::vector<FieldRef>& fields,
            const std::function<void(const std::string& name)>& changed = {}) const;
  /// The file --config names; empty for none.
  std::filesystem::path config_file() const;
  /// What is in it; an empty object without one.
  /// throws  ConfigError
  nlohmann::json config() const;
  /// Whether --print-config came.
  bool print_config() const { return given("--print-config"); }

  /// throws  CLI::RequiredError if a file that the command cannot do without is not named
  static void require(const std::string& flag, const std::filesystem::path& value);

  CLI::App& command() const { return command_; }
  std::string name() const { return command_.get_name(); }
  const std::vector<Flag>& all() const { return flags_; }

 private:
  void add_one(const FieldRef& field, const std::string& heading);
  std::vector<Flag>::const_iterator find(const FieldRef& field) const;

  CLI::App& command_;
  std::vector<Flag> flags_;
};

/// The first spelling of a field's flag, e.g. `--image-dir`.
std::string flag_of(const FieldRef& field);

/// Brings a configuration into effect: flags over the file over what it holds.
/// throws  ConfigError
template <HasFields S>
void read_config(const Flags& flags, S& config) {
  from_json(flags.config(), config, flags.config_file().string());
  flags.read(collect_fields(config));
}

/// One of several things that a command does, each with fields of its own.
struct Mode {
  std::string flag;  ///< what asks for it, e.g. `--dsm` or `--task mono`
  std::vector<FieldRef> fields;
};
/// throws  ConfigError for a flag of `modes` that came though `chosen` does not have it
void refuse_others(const Flags& flags, const std::vector<Mode>& modes, const Mode& chosen);

}  // namespace satsurf::app

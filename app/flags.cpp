// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/flags.h"

#include "satsurf/core/error.h"

#include <algorithm>
#include <variant>

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace satsurf::app {
namespace {

std::string spellings_of(const FieldRef& field) {
  return field.meta.flag.empty() ? "--" + field.name : field.meta.flag;
}

/// A bool that the command line spells on its own.
bool is_switch(const FieldRef& field) {
  return field.kind() == FieldRef::Kind::boolean && !field.is_list() && !field.meta.flag.empty();
}

bool is_pair(const FieldRef& field) { return std::holds_alternative<OptionalPair*>(field.target); }

std::string about(const FieldRef& field, const FieldInfo& info) {
  std::string text = info.help;
  if (!info.range.empty()) text += " (" + info.range + ")";
  if (!field.meta.automatic.empty()) text += " [" + field.meta.automatic + "]";
  return text;
}

std::string value_name(const FieldRef& field, const FieldInfo& info) {
  std::string text = info.type;
  if (field.is_path()) text = "FILE";
  if (!field.meta.placeholder.empty()) text = field.meta.placeholder;
  return info.unit.empty() ? text : text + " in " + info.unit;
}

}  // namespace

std::string flag_of(const FieldRef& field) {
  const std::string all = spellings_of(field);
  return all.substr(0, all.find(','));
}

std::vector<Flag>::const_iterator Flags::find(const FieldRef& field) const {
  return std::ranges::find_if(
      flags_, [&](const Flag& flag) { return flag.option->check_name(flag_of(field)); });
}

void Flags::add_one(const FieldRef& field, const std::string& heading) {
  FieldInfo info = detail::describe_ref(field);
  if (field.meta.placeholder == "DIR") info.type = field.is_list() ? "folders" : "folder";
  const std::string description = about(field, info);  // CLI11 would set a variable text
  CLI::Option* option = is_switch(field) ? command_.add_flag(spellings_of(field), description)
                                         : command_.add_option(spellings_of(field), description);
  option->group(heading);
  if (!is_switch(field)) {
    option->type_name(value_name(field, info));
    if (field.meta.automatic.empty()) option->default_str(info.value);
    if (is_pair(field)) option->expected(2)->option_text(value_name(field, info));
    if (field.is_path() && field.is_list()) option->expected(1, -1)->allow_extra_args();
  }
  flags_.push_back({option, info, is_switch(field)});
}

void Flags::add(const std::vector<FieldRef>& fields, const std::string& heading,
                const std::string& shared) {
  for (const FieldRef& field : fields) {
    const auto found = find(field);
    if (found == flags_.end()) {
      add_one(field, heading);
      continue;
    }
    Flag& known = flags_[static_cast<std::size_t>(found - flags_.begin())];
    if (!shared.empty()) known.option->group(shared);
    const std::string value = detail::describe_ref(field).value;
    // where the choice of the struct is itself a field, its value says nothing new
    if (value == known.info.value || heading.ends_with(" " + value)) continue;
    const std::string other = "; " + heading + ": " + value;
    known.info.help += other;
    known.option->description(known.option->get_description() + other);
  }
}

void Flags::add_config() {
  const std::string file =
                        "JSON file with any of the configuration's fields, or the record of a run",
                    print = "print the configuration in effect and stop";
  const FieldInfo none{"config", "file", "", "", "", file};
  flags_.push_back({command_.add_option("--config", file)->type_name("FILE"), none, false});
  flags_.push_back({command_.add_flag("--print-config", print),
                    {"print_config", "bool", "false", "", "", print},
                    true});
}

void Flags::read(const std::vector<FieldRef>& fields,
                 const std::function<void(const std::string& name)>& changed) const {
  for (const FieldRef& field : fields) {
    const auto flag = find(field);
    if (flag == flags_.end() || flag->option->count() == 0) continue;
    FieldRef as_flag = field;  // errors tell of the flag; what 0 stands for is not for flags
    as_flag.name = flag_of(field);
    as_flag.meta.automatic.clear();
    const std::vector<std::string> texts = flag->option->results();
    if (flag->is_switch)
      *std::get<bool*>(field.target) = (flag->info.value == "true") != flag->option->as<bool>();
    else if (is_pair(field) || (field.is_path() && field.is_list()))
      detail::assign_field(as_flag, texts, fmt::format("{}", fmt::join(texts, " ")), name());
    else
      detail::set_ref({as_flag}, as_flag.name, texts.front(), name());
    if (changed) changed(field.name);
  }
}

std::filesystem::path Flags::config_file() const {
  return given("--config") ? command_.get_option("--config")->as<std::string>() : std::string();
}

nlohmann::json Flags::config() const {
  const std::filesystem::path file = config_file();
  return file.empty() ? nlohmann::json::object() : load_config(file, name());
}

void Flags::require(const std::string& flag, const std::filesystem::path& value) {
  if (value.empty()) throw CLI::RequiredError(flag);
}

void refuse_others(const Flags& flags, const std::vector<Mode>& modes, const Mode& chosen) {
  const auto has = [](const Mode& mode, const std::string& flag) {
    return std::ranges::any_of(mode.fields,
                               [&](const FieldRef& field) { return flag_of(field) == flag; });
  };
  for (const Mode& mode : modes)
    for (const FieldRef& field : mode.fields) {
      const std::string flag = flag_of(field);
      if (!flags.given(flag) || has(chosen, flag)) continue;
      std::vector<std::string> wanted;
      for (const Mode& other : modes)
        if (has(other, flag)) wanted.push_back(other.flag);
      throw ConfigError(fmt::format("{} {}: {} came, expected only with {}", flags.name(),
                                    chosen.flag, flag, fmt::join(wanted, " or ")));
    }
}

}  // namespace satsurf::app

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/fields.h"

#include <filesystem>
#include <string>
#include <string_view>
#include <utility>

#include <nlohmann/json.hpp>

namespace satsurf {

/// Parses one JSON document, as everything here that reads JSON does, in time linear in its length;
/// stricter than the standard: a repeated key is an error, and so are nesting deeper than 64 and more
/// than 2,000,000 values; headers, records and views have thousands.
/// text    the document
/// where   begins the error text
/// throws  IoError `where: line 3, column 5: ...`
nlohmann::json parse_json(std::string_view text, const std::string& where);
/// Reads one JSON document, as strictly as `parse_json`.
/// throws  IoError that names the file, and the line where it is malformed; for one larger than 64 MiB
nlohmann::json load_json_file(const std::filesystem::path& path);

/// A document as text. Names of files are bytes of any kind: those that are no UTF-8 become U+FFFD.
/// indent  blanks a level; all in one line below 0
std::string json_text(const nlohmann::json& value, int indent = -1);

namespace detail {
nlohmann::json refs_to_json(const std::vector<FieldRef>& fields);
void refs_from_json(const nlohmann::json& json, const std::vector<FieldRef>& fields,
                    const std::string& where);
}  // namespace detail

/// The fields as nested objects, in alphabetical order of their names; texts as `json_text` has them.
/// throws  ConfigError for NaN and infinities, which JSON cannot hold
template <HasFields S>
nlohmann::json to_json(const S& s) {
  S copy = s;
  return detail::refs_to_json(collect_fields(copy));
}

/// Sets the fields that `json` names and leaves the others as they are.
/// json    an object, nested as the struct is
/// s       the struct; unchanged when this throws
/// where   begins the error text
/// throws  ConfigError that names the field, what came and what was wanted
template <HasFields S>
void from_json(const nlohmann::json& json, S& s, const std::string& where) {
  S copy = s;
  detail::refs_from_json(json, collect_fields(copy), where);
  s = std::move(copy);
}

}  // namespace satsurf

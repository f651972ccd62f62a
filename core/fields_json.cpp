// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/fields_json.h"

#include "satsurf/core/error.h"
#include "satsurf/core/files.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <utility>
#include <vector>

namespace satsurf {
namespace {

using nlohmann::json;

constexpr std::size_t kMostNesting =
    64;  // deeper than any file of ours; a document of brackets is refused
constexpr std::size_t kMostValues =
    2'000'000;  // of some 160 bytes each, which may have 3 in the file

/// `line 3, column 5` of a byte counted from 1, as the parser counts.
std::string position(std::string_view text, std::size_t byte) {
  const std::string_view before = text.substr(0, std::min(byte > 0 ? byte - 1 : 0, text.size()));
  const auto line = 1 + std::count(before.begin(), before.end(), '\n');
  const auto column = before.size() - (before.rfind('\n') + 1) + 1;  // npos + 1 is 0
  return "line " + std::to_string(line) + ", column " + std::to_string(column);
}

/// The parser's own words without its prefix of exception number and place.
std::string reason(const std::string& what) {
  const std::size_t column = what.find("column ");
  if (const std::size_t number = what.find("] ");
      column == std::string::npos && number < what.size())
    return what.substr(number + 2);
  const std::size_t colon = what.find(": ", column == std::string::npos ? 0 : column);
  return colon == std::string::npos ? what : what.substr(colon + 2);
}

/// Builds a document from the parser's events. The parser's own filter, which could refuse as well, looks
/// through a container again after each value in it.
class Builder {
 public:
  Builder(json& document, const std::string& where) : document_(document), where_(where) {}

  bool null() { return add(nullptr); }
  bool boolean(bool value) { return add(value); }
  bool number_integer(json::number_integer_t value) { return add(value); }
  bool number_unsigned(json::number_unsigned_t value) { return add(value); }
  bool number_float(json::number_float_t value, const std::string&) { return add(value); }
  bool string(std::string& value) { return add(std::move(value)); }
  bool binary(json::binary_t& value) { return add(std::move(value)); }
  bool start_object(std::size_t) { return open(json::object()); }
  bool start_array(std::size_t) { return open(json::array()); }
  bool end_object() { return close(); }
  bool end_array() { return close(); }
  bool key(std::string& name) {
    const auto [at, is_new] = open_.back()->get_ref<json::object_t&>().try_emplace(std::move(name));
    if (!is_new) throw IoError(where_ + ": key " + json(at->first).dump() + " appears twice");
    of_key_ = &at->second;
    return true;
  }
  template <class E>
  bool parse_error(std::size_t, const std::string&, const E& error) {
    throw error;
  }

 private:
  json& place(json&& value) {
    if (++count_ > kMostValues)
      throw IoError(where_ + ": more than " + std::to_string(kMostValues) +
                    " values, expected fewer");
    if (open_.empty()) return document_ = std::move(value);
    if (open_.back()->is_array()) return open_.back()->emplace_back(std::move(value));
    return *of_key_ = std::move(value);
  }
  bool add(json&& value) {
    place(std::move(value));
    return true;
  }
  bool open(json&& container) {
    if (open_.size() == kMostNesting)
      throw IoError(where_ + ": nested deeper than " + std::to_string(kMostNesting) + " levels");
    open_.push_back(&place(std::move(container)));
    return true;
  }
  bool close() {
    open_.pop_back();
    return true;
  }

  json& document_;
  const std::string& where_;
  std::vector<json*> open_;  // containers, the innermost last: only that one grows
  json* of_key_ = nullptr;
  std::size_t count_ = 0;
};

bool kind_matches(FieldRef::Kind kind, const json& value) {
  switch (kind) {
    case FieldRef::Kind::boolean:
      return value.is_boolean();
    case FieldRef::Kind::integer:
    case FieldRef::Kind::number:
      return value.is_number();
    case FieldRef::Kind::text:
      return value.is_string();
  }
  return false;
}

std::string element_text(const json& value) {
  return value.is_string() ? value.get<std::string>() : value.dump();
}

void assign(const FieldRef& field, const json& value, const std::string& where) {
  const std::string shown = json_text(value);
  std::vector<std::string> elements;
  if (field.is_list() != value.is_array()) detail::refuse_value(field, shown, where);
  const auto add = [&](const json& element) {
    if (!kind_matches(field.kind(), element)) detail::refuse_value(field, shown, where);
    elements.push_back(element_text(element));
  };
  if (field.is_list())
    for (const json& element : value) add(element);
  else
    add(value);
  detail::assign_field(field, elements, shown, where);
}

/// Reads the object of the fields whose names begin with `prefix` (empty, or ending in a dot).
void read_object(const json& object, const std::string& prefix, const std::vector<FieldRef>& fields,
                 const std::string& where) {
  std::vector<std::string> known;  // keys of this level, in the order of declaration
  for (const FieldRef& f : fields) {
    if (!f.name.starts_with(prefix)) continue;
    const std::string key = f.name.substr(0, f.name.find('.', prefix.size()));
    if (known.empty() || known.back() != key) known.push_back(key);
  }
  if (!object.is_object()) {
    const std::string name =
        prefix.empty() ? "the configuration" : prefix.substr(0, prefix.size() - 1);
    throw ConfigError(where + ": " + name + " is " + object.dump() + ", expected an object");
  }
  for (const auto& [key, value] : object.items()) {
    const std::string name = prefix + key;
    if (std::ranges::find(known, name) == known.end()) detail::refuse_unknown(name, known, where);
    const auto field = std::ranges::find(fields, name, &FieldRef::name);
    if (field != fields.end())
      assign(*field, value, where);
    else
      read_object(value, name + '.', fields, where);
  }
}

template <class E>
json element_json(const E& value, const std::string& name) {
  if constexpr (std::is_floating_point_v<E>) {
    if (!std::isfinite(value))
      throw ConfigError(name + ": " + std::to_string(value) + ", expected a finite number");
    char buffer[64];  // 0.1f is saved as 0.1, not as 0.10000000149011612
    const char* end = std::to_chars(buffer, buffer + sizeof buffer, value).ptr;
    double d = 0;
    std::from_chars(buffer, end, d);
    return d;
  } else if constexpr (std::is_same_v<E, std::filesystem::path>) {
    return value.string();
  } else {
    return value;
  }
}

/// The value of one field, whatever its form.
struct ToJson {
  const std::string& name;
  const std::vector<std::string>& choices;

  template <class E>
  json list(const E& values) const {
    json out = json::array();
    for (const auto& x : values) out.push_back(element_json(x, name));
    return out;
  }
  template <class E>
  json operator()(E* value) const {
    return element_json(*value, name);
  }
  template <class E>
  json operator()(std::vector<E>* values) const {
    return list(*values);
  }
  json operator()(OptionalPair* pair) const { return *pair ? list(**pair) : json(); }
  json operator()(const EnumTarget& target) const {
    json out = json::array();
    for (const std::size_t number : target.get(target.values)) out.push_back(choices[number]);
    return target.list ? out : out.front();
  }
  json operator()(std::vector<bool>* values) const { return *values; }  // its elements are proxies
  template <class E>
  json operator()(std::span<E> values) const {
    return list(values);
  }
};

}  // namespace

json parse_json(std::string_view text, const std::string& where) {
  json document;
  Builder builder(document, where);
  try {
    json::sax_parse(text.begin(), text.end(), &builder);
    return document;
  } catch (const json::parse_error& e) {
    const std::string why = reason(e.what());
    const bool literal = why.find("invalid literal") != std::string::npos;
    throw IoError(where + ": " + position(text, e.byte) + ": " + why +
                  (literal ? ", expected a JSON value (NaN and Infinity are none)" : ""));
  } catch (const json::exception& e) {  // a number out of range
    throw IoError(where + ": " + reason(e.what()));
  }
}

json load_json_file(const std::filesystem::path& path) {
  return parse_json(read_text_file(path, "a JSON file"), path.string());
}

std::string json_text(const json& value, int indent) {
  return value.dump(indent, ' ', false, json::error_handler_t::replace);
}

json detail::refs_to_json(const std::vector<FieldRef>& fields) {
  json root = json::object();
  for (const FieldRef& f : fields) {
    json value = std::visit(ToJson{f.name, f.meta.choices}, f.target);
    if (value.is_null()) continue;  // an optional pair without a value
    if (f.kind() == FieldRef::Kind::text) value = json::parse(json_text(value));
    json* at = &root;
    std::size_t begin = 0;
    for (std::size_t dot; (dot = f.name.find('.', begin)) != std::string::npos; begin = dot + 1)
      at = &(*at)[f.name.substr(begin, dot - begin)];
    (*at)[f.name.substr(begin)] = std::move(value);
  }
  return root;
}

void detail::refs_from_json(const json& value, const std::vector<FieldRef>& fields,
                            const std::string& where) {
  read_object(value, "", fields, where);
}

}  // namespace satsurf

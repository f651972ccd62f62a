// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/shape.h"

#include <array>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <type_traits>
#include <utility>
#include <variant>
#include <vector>

namespace satsurf {

// A parameter struct declares each field once, in a static function template
//
//   struct TrainConfig {
//     double lr = 1e-3;
//     Index steps = 1000;
//     ModelConfig model;
//     template <class Self, class V>
//     static void fields(Self& s, V&& v) {
//       v("lr", s.lr, Field{.help = "peak learning rate", .min = 0, .max = 1});
//       v("steps", s.steps, Field{.help = "optimiser steps", .min = 1});
//       v("model", s.model);
//     }
//   };
//
// and JSON (core/fields_json.h), command-line flags, help and the saved record are all derived from
// it. Supported field types: bool, int, Index, std::uint64_t, float, double, std::string,
// std::filesystem::path and enumerations, std::vector and std::array of those (of enumerations
// std::vector only), OptionalPair, and nested structs, whose fields are named `model.base`.

/// Two numbers or nothing, which JSON leaves out.
using OptionalPair = std::optional<std::array<double, 2>>;

/// The names of an enumeration's values, in the order of the values from 0 on, as files and flags
/// spell them. To be specialised for every enumeration that is a field:
///   enum class Fusion { none, naive, cmmf };
///   template <> struct EnumNames<Fusion> {
///     static constexpr std::array names{"none", "naive", "cmmf"};
///   };
template <class E>
struct EnumNames;
template <class E>
concept NamedEnum = std::is_enum_v<E> && requires { EnumNames<E>::names.size(); };

/// The name of a value.
template <NamedEnum E>
std::string enum_name(E value) {
  return EnumNames<E>::names[static_cast<std::size_t>(value)];
}

/// What is said about a field besides its name and type.
struct Field {
  std::string help{};
  std::string unit{};
  double min = -1e300, max = 1e300;    ///< inclusive range of every number in the field
  std::vector<std::string> choices{};  ///< allowed strings, empty for any
  /// What 0, the empty text or nothing stands for, e.g. `two pixels on the ground`. Then 0 may lie
  /// outside the range.
  std::string automatic{};
  /// How the command line spells it where that is not `--` and the name: spellings separated by
  /// commas, e.g. `--image-dir`; one without dashes is positional. A bool that has one is a switch:
  /// it takes no value and turns the default round.
  std::string flag{};
  std::string placeholder{};  ///< what the help calls the value, e.g. `DIR`; empty for its type
};

/// One row of the help and of the documentation.
struct FieldInfo {
  std::string name;   ///< dotted, as in `--model.base`
  std::string type;   ///< e.g. `integer`, `bool`, `3 comma-separated numbers`
  std::string value;  ///< as `set_field` reads it; the default where the struct is a fresh one
  std::string range;  ///< e.g. `0 to 1`, `>= 1`, `l1 | l2`; empty if anything goes
  std::string unit;
  std::string help;
  std::string automatic{};  ///< as in Field
  friend bool operator==(const FieldInfo&, const FieldInfo&) = default;
};

// Where a field lives: a scalar, a list that may be resized, a list of fixed length, an optional
// pair, or an enumeration.

/// An enumeration, or a list of its values, by their numbers; its names are the field's choices.
struct EnumTarget {
  void* values;
  bool list;
  std::vector<std::size_t> (*get)(const void* values);
  void (*set)(void* values, const std::vector<std::size_t>& numbers);
};
template <class... E>
using FieldTargetWith =
    std::variant<E*..., std::vector<E>*..., std::span<E>..., OptionalPair*, EnumTarget>;
using FieldTarget = FieldTargetWith<bool, int, Index, std::uint64_t, float, double, std::string,
                                    std::filesystem::path>;

/// One field of a live struct; valid as long as the struct is.
struct FieldRef {
  enum class Kind { boolean, integer, number, text };

  std::string name;
  Field meta;
  FieldTarget target;

  Kind kind() const;     ///< of the field, or of its elements
  bool is_list() const;  ///< std::vector, std::array or OptionalPair
  bool is_path() const;  ///< std::filesystem::path or a list of it
};

namespace detail {

template <class E>
FieldTarget field_target(E& x) {
  return &x;
}
template <class E, std::size_t N>
FieldTarget field_target(std::array<E, N>& x) {
  return std::span<E>(x);
}

template <NamedEnum E>
FieldTarget field_target(E& x) {
  return EnumTarget{&x, false,
                    [](const void* values) {
                      return std::vector{static_cast<std::size_t>(*static_cast<const E*>(values))};
                    },
                    [](void* values, const std::vector<std::size_t>& numbers) {
                      *static_cast<E*>(values) = static_cast<E>(numbers.front());
                    }};
}
template <NamedEnum E>
FieldTarget field_target(std::vector<E>& x) {
  return EnumTarget{&x, true,
                    [](const void* values) {
                      std::vector<std::size_t> numbers;
                      for (const E value : *static_cast<const std::vector<E>*>(values))
                        numbers.push_back(static_cast<std::size_t>(value));
                      return numbers;
                    },
                    [](void* values, const std::vector<std::size_t>& numbers) {
                      auto& list = *static_cast<std::vector<E>*>(values);
                      list.clear();
                      for (const std::size_t number : numbers)
                        list.push_back(static_cast<E>(number));
                    }};
}

/// The choices a field has by its type: the names of an enumeration, none for other types.
template <class X>
std::vector<std::string> choices_of() {
  if constexpr (NamedEnum<X>)
    return {EnumNames<X>::names.begin(), EnumNames<X>::names.end()};
  else if constexpr (requires {
                       typename X::value_type;
                       requires NamedEnum<typename X::value_type>;
                     })
    return choices_of<typename X::value_type>();
  else
    return {};
}

/// Visitor that flattens a parameter struct into FieldRefs.
struct FieldCollector {
  std::string prefix;
  std::vector<FieldRef>& out;

  template <class X>
  void operator()(const char* name, X& x, Field meta = {}) {
    if constexpr (requires { X::fields(x, *this); }) {
      X::fields(x, FieldCollector{prefix + name + '.', out});
    } else {
      if (meta.choices.empty()) meta.choices = choices_of<X>();
      out.push_back({prefix + name, std::move(meta), field_target(x)});
    }
  }
};

FieldInfo describe_ref(const FieldRef& field);
void set_ref(const std::vector<FieldRef>& fields, const std::string& name, const std::string& text,
             const std::string& where);
void check_refs(const std::vector<FieldRef>& fields, const std::string& where);
/// Parses, checks and stores the elements of one field (a scalar is one element). `shown` is how
/// the value appears in an error.
void assign_field(const FieldRef& field, const std::vector<std::string>& elements,
                  const std::string& shown, const std::string& where);
[[noreturn]] void refuse_value(const FieldRef& field, const std::string& shown,
                               const std::string& where);
[[noreturn]] void refuse_choice(const std::string& name, const std::vector<std::string>& choices,
                                const std::string& where);
/// Names the nearest of `known`, or all of them if none is near.
[[noreturn]] void refuse_unknown(const std::string& name, const std::vector<std::string>& known,
                                 const std::string& where);

}  // namespace detail

/// A struct that declares its fields as above.
template <class S>
concept HasFields = requires(S& s, detail::FieldCollector& v) { S::fields(s, v); };

/// The fields of `s` in the order of declaration, nested ones in place.
template <HasFields S>
std::vector<FieldRef> collect_fields(S& s) {
  std::vector<FieldRef> out;
  S::fields(s, detail::FieldCollector{"", out});
  return out;
}

/// Names, types, values, ranges and help of all fields.
template <HasFields S>
std::vector<FieldInfo> describe(const S& s = S()) {
  S copy = s;
  std::vector<FieldInfo> rows;
  for (const FieldRef& field : collect_fields(copy)) rows.push_back(detail::describe_ref(field));
  return rows;
}

/// Sets one field from text, as a command line gives it. Lists are separated by commas.
/// s            the struct; unchanged when this throws
/// dotted_name  as in FieldInfo
/// text         the value
/// where        begins the error text
/// throws       ConfigError
template <HasFields S>
void set_field(S& s, const std::string& dotted_name, const std::string& text,
               const std::string& where = "option") {
  detail::set_ref(collect_fields(s), dotted_name, text, where);
}

/// The value of that name.
/// where   begins the error text
/// throws  ConfigError naming the choices
template <NamedEnum E>
E enum_from(const std::string& name, const std::string& where) {
  const auto& names = EnumNames<E>::names;
  for (std::size_t i = 0; i < names.size(); ++i)
    if (name == names[i]) return static_cast<E>(i);
  detail::refuse_choice(name, detail::choices_of<E>(), where);
}

/// Checks that the values of a struct filled in by code lie in their ranges.
/// s       the struct
/// where   begins the error text
/// throws  ConfigError
template <HasFields S>
void check_fields(const S& s, const std::string& where) {
  S copy = s;
  detail::check_refs(collect_fields(copy), where);
}

/// The rows as a Markdown table, for the manual.
std::string markdown_table(const std::vector<FieldInfo>& rows);

}  // namespace satsurf

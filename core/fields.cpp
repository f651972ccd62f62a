// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/fields.h"

#include "satsurf/core/error.h"
#include "satsurf/core/nearest.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <limits>

namespace satsurf {
namespace {

constexpr double kUnbounded = 1e300;  // Field's default limits

/// Element type of a target: E for E*, std::vector<E>* and std::span<E>.
template <class T>
struct ElementOf;
template <class E>
struct ElementOf<E*> {
  using type = E;
};
template <class E>
struct ElementOf<std::vector<E>*> {
  using type = E;
};
template <class E>
struct ElementOf<std::span<E>> {
  using type = E;
};
template <>
struct ElementOf<OptionalPair*> {
  using type = double;
};
template <>
struct ElementOf<EnumTarget> {  // as files and flags have it
  using type = std::string;
};

template <class T>
inline constexpr bool kIsVector = false;
template <class E>
inline constexpr bool kIsVector<std::vector<E>*> = true;
template <class T>
inline constexpr bool kIsSpan = false;
template <class E>
inline constexpr bool kIsSpan<std::span<E>> = true;

template <class E>
inline constexpr bool kIsText =
    std::is_same_v<E, std::string> || std::is_same_v<E, std::filesystem::path>;

template <class E>
constexpr FieldRef::Kind kind_of() {
  if constexpr (std::is_same_v<E, bool>)
    return FieldRef::Kind::boolean;
  else if constexpr (std::is_integral_v<E>)
    return FieldRef::Kind::integer;
  else if constexpr (std::is_floating_point_v<E>)
    return FieldRef::Kind::number;
  else
    return FieldRef::Kind::text;
}

template <class E>
std::string to_text(const E& value) {
  if constexpr (std::is_same_v<E, bool>) {
    return value ? "true" : "false";
  } else if constexpr (std::is_same_v<E, std::string>) {
    return value;
  } else if constexpr (std::is_same_v<E, std::filesystem::path>) {
    return value.string();
  } else {
    char buffer[64];  // the shortest text that reads back as the same number
    const auto end = std::to_chars(buffer, buffer + sizeof buffer, value).ptr;
    return {buffer, end};
  }
}

/// True if the whole of `text` is one value of type E; `1e4` counts as an integer.
template <class E>
bool parse(const std::string& text, E& value) {
  if constexpr (std::is_same_v<E, bool>) {
    value = text == "true" || text == "1";
    return value || text == "false" || text == "0";
  } else if constexpr (kIsText<E>) {
    value = text;
    return true;
  } else {
    const char *begin = text.data(), *end = begin + text.size();
    if (const auto r = std::from_chars(begin, end, value); r.ec == std::errc{} && r.ptr == end) {
      if constexpr (std::is_floating_point_v<E>) return std::isfinite(value);
      return true;
    }
    if constexpr (std::is_integral_v<E>) {
      double d = 0;
      const auto r = std::from_chars(begin, end, d);
      constexpr double kExact = 0x1p53;  // beyond, a double no longer holds every integer
      if (r.ec != std::errc{} || r.ptr != end || d != std::floor(d) || std::abs(d) > kExact)
        return false;
      if (d < static_cast<double>(std::numeric_limits<E>::min()) ||
          d > static_cast<double>(std::numeric_limits<E>::max()))
        return false;
      value = static_cast<E>(d);
      return true;
    }
    return false;
  }
}

template <class E>
bool allowed(const Field& meta, const E& value) {
  if constexpr (std::is_same_v<E, std::string>) {
    return meta.choices.empty() || std::ranges::find(meta.choices, value) != meta.choices.end();
  } else if constexpr (std::is_same_v<E, bool> || std::is_same_v<E, std::filesystem::path>) {
    return true;
  } else {
    const auto d = static_cast<double>(value);
    return (d >= meta.min && d <= meta.max) ||  // false for NaN
           (d == 0 && !meta.automatic.empty());
  }
}

std::string join(const std::vector<std::string>& words, const char* separator) {
  std::string out;
  for (std::size_t i = 0; i < words.size(); ++i) out += (i > 0 ? separator : "") + words[i];
  return out;
}

std::vector<std::string> split(const std::string& text) {
  std::vector<std::string> out;
  if (text.empty()) return out;
  for (std::size_t begin = 0; begin <= text.size();) {
    const std::size_t end = std::min(text.find(',', begin), text.size());
    out.push_back(text.substr(begin, end - begin));
    begin = end + 1;
  }
  return out;
}

/// The values of a field, whatever its form.
std::vector<std::string> texts_of(const FieldRef& field) {
  return std::visit(
      [&choices = field.meta.choices](const auto& t) {
        using Target = std::remove_cvref_t<decltype(t)>;
        using E = typename ElementOf<Target>::type;
        std::vector<std::string> out;
        if constexpr (std::is_same_v<Target, EnumTarget>)
          for (const std::size_t number : t.get(t.values)) out.push_back(choices[number]);
        else if constexpr (kIsVector<Target>)
          for (const auto& x : *t) out.push_back(to_text<E>(x));
        else if constexpr (kIsSpan<Target>)
          for (const auto& x : t) out.push_back(to_text<E>(x));
        else if constexpr (std::is_same_v<Target, OptionalPair*>)
          for (std::size_t i = 0; *t && i < 2; ++i) out.push_back(to_text((**t)[i]));
        else
          out.push_back(to_text<E>(*t));
        return out;
      },
      field.target);
}

std::size_t fixed_length(const FieldTarget& target) {
  return std::visit(
      [](const auto& t) -> std::size_t {
        using Target = std::remove_cvref_t<decltype(t)>;
        if constexpr (kIsSpan<Target>)
          return t.size();
        else
          return std::is_same_v<Target, OptionalPair*> ? 2 : 0;
      },
      target);
}

struct Limits {
  double min, max;
};

/// The field's limits, and those of its type where it has none of its own.
Limits limits_of(const FieldRef& field) {
  return std::visit(
      [&](const auto& t) -> Limits {
        using E = typename ElementOf<std::remove_cvref_t<decltype(t)>>::type;
        Limits l{field.meta.min, field.meta.max};
        if constexpr (std::is_same_v<E, std::uint64_t>) l.min = std::max(l.min, 0.0);
        if constexpr (std::is_same_v<E, int>) {
          if (l.min > -kUnbounded || l.max < kUnbounded) return l;
          return {std::numeric_limits<int>::min(), std::numeric_limits<int>::max()};
        }
        return l;
      },
      field.target);
}

std::string expected_text(const FieldRef& field) {
  static constexpr const char* kOne[] = {"true or false", "an integer", "a number", "a text"};
  static constexpr const char* kMany[] = {"true or false", "integers", "numbers", "texts"};
  const auto kind = static_cast<std::size_t>(field.kind());
  std::string text;
  if (!field.is_list())
    text = kOne[kind];
  else if (const std::size_t n = fixed_length(field.target); n > 0)
    text = std::to_string(n) + " x " + kMany[kind];
  else
    text = std::string("a list of ") + kMany[kind];
  if (!field.meta.choices.empty())
    return (field.is_list() ? text + " out of " : "one of ") + join(field.meta.choices, ", ");
  if (field.kind() == FieldRef::Kind::integer || field.kind() == FieldRef::Kind::number) {
    const Limits l = limits_of(field);
    const bool low = l.min > -kUnbounded, high = l.max < kUnbounded;
    if (low && high)
      text += " from " + to_text(l.min) + " to " + to_text(l.max);
    else if (low)
      text += " of at least " + to_text(l.min);
    else if (high)
      text += " of at most " + to_text(l.max);
  }
  return text;
}

std::string in_quotes(const std::string& text) { return "'" + text + "'"; }

std::string range_text(const FieldRef& field) {
  if (!field.meta.choices.empty()) return join(field.meta.choices, " | ");
  if (field.kind() != FieldRef::Kind::integer && field.kind() != FieldRef::Kind::number) return "";
  const bool low = field.meta.min > -kUnbounded, high = field.meta.max < kUnbounded;
  if (low && high) return to_text(field.meta.min) + " to " + to_text(field.meta.max);
  if (low) return ">= " + to_text(field.meta.min);
  return high ? "<= " + to_text(field.meta.max) : "";
}

std::string type_text(const FieldRef& field) {
  static constexpr const char* kNames[] = {"bool", "integer", "number", "text"};
  const std::string name =
      field.is_path() ? "file" : kNames[static_cast<std::size_t>(field.kind())];
  if (!field.is_list()) return name;
  if (field.is_path()) return name + "s";
  if (std::holds_alternative<OptionalPair*>(field.target)) return "2 " + name + "s";
  const std::size_t n = fixed_length(field.target);
  return (n > 0 ? std::to_string(n) + " " : "") + "comma-separated " + name + "s";
}

}  // namespace

FieldRef::Kind FieldRef::kind() const {
  return std::visit(
      [](const auto& t) {
        return kind_of<typename ElementOf<std::remove_cvref_t<decltype(t)>>::type>();
      },
      target);
}

bool FieldRef::is_list() const {
  return std::visit(
      [](const auto& t) {
        using Target = std::remove_cvref_t<decltype(t)>;
        if constexpr (std::is_same_v<Target, EnumTarget>) return t.list;
        return kIsVector<Target> || kIsSpan<Target> || std::is_same_v<Target, OptionalPair*>;
      },
      target);
}

bool FieldRef::is_path() const {
  return std::visit(
      [](const auto& t) {
        using E = typename ElementOf<std::remove_cvref_t<decltype(t)>>::type;
        return std::is_same_v<E, std::filesystem::path>;
      },
      target);
}

void detail::refuse_value(const FieldRef& field, const std::string& shown,
                          const std::string& where) {
  throw ConfigError(where + ": " + field.name + " is " + shown + ", expected " +
                    expected_text(field));
}

void detail::refuse_choice(const std::string& name, const std::vector<std::string>& choices,
                           const std::string& where) {
  throw ConfigError(where + ": " + in_quotes(name) + ", expected one of " + join(choices, ", "));
}

void detail::refuse_unknown(const std::string& name, const std::vector<std::string>& known,
                            const std::string& where) {
  const std::optional<std::string> meant = nearest(name, known);
  throw ConfigError(where + ": unknown key " + in_quotes(name) +
                    (meant ? ", did you mean " + in_quotes(*meant) + "?"
                           : ", expected one of " + join(known, ", ")));
}

void detail::assign_field(const FieldRef& field, const std::vector<std::string>& elements,
                          const std::string& shown, const std::string& where) {
  std::visit(
      [&](const auto& t) {
        using Target = std::remove_cvref_t<decltype(t)>;
        using E = typename ElementOf<Target>::type;
        std::vector<E> values;
        for (const std::string& text : elements) {
          E value{};
          if (!parse(text, value) || !allowed(field.meta, value)) refuse_value(field, shown, where);
          values.push_back(value);
        }
        if constexpr (std::is_same_v<Target, EnumTarget>) {
          if (!t.list && values.size() != 1) refuse_value(field, shown, where);
          std::vector<std::size_t> numbers;
          for (const E& value : values)
            numbers.push_back(static_cast<std::size_t>(
                std::ranges::find(field.meta.choices, value) - field.meta.choices.begin()));
          t.set(t.values, numbers);
        } else if constexpr (kIsVector<Target>) {
          *t = values;
        } else if constexpr (kIsSpan<Target>) {
          if (values.size() != t.size()) refuse_value(field, shown, where);
          std::copy(values.begin(), values.end(), t.begin());
        } else if constexpr (std::is_same_v<Target, OptionalPair*>) {
          if (values.empty()) return t->reset();
          if (values.size() != 2) refuse_value(field, shown, where);
          *t = {values[0], values[1]};
        } else {
          if (values.size() != 1) refuse_value(field, shown, where);
          *t = values[0];
        }
      },
      field.target);
}

void detail::set_ref(const std::vector<FieldRef>& fields, const std::string& name,
                     const std::string& text, const std::string& where) {
  for (const FieldRef& f : fields)
    if (f.name == name)
      return assign_field(f, f.is_list() ? split(text) : std::vector{text}, in_quotes(text), where);
  std::vector<std::string> known;
  for (const FieldRef& f : fields) known.push_back(f.name);
  refuse_unknown(name, known, where);
}

void detail::check_refs(const std::vector<FieldRef>& fields, const std::string& where) {
  for (const FieldRef& f : fields) {
    const auto texts = texts_of(f);
    assign_field(f, texts, join(texts, ","), where);  // stores what is already there
  }
}

FieldInfo detail::describe_ref(const FieldRef& f) {
  return {f.name,      type_text(f), join(texts_of(f), ","), range_text(f),
          f.meta.unit, f.meta.help,  f.meta.automatic};
}

std::string markdown_table(const std::vector<FieldInfo>& rows) {
  const auto cell = [](const std::string& text) {
    std::string out;
    for (const char c : text) {
      if (c == '|') out += '\\';  // a bare bar would begin a new cell
      out += c;
    }
    return out;
  };
  const auto code = [&](const std::string& text) {
    return text.empty() ? std::string() : "`" + cell(text) + "`";
  };
  std::string out =
      "| Name | Type | Default | Range | Unit | Meaning |\n| --- | --- | --- | --- | --- | --- |\n";
  for (const FieldInfo& r : rows)
    out += "| " + code(r.name) + " | " + r.type + " | " +
           (r.automatic.empty() ? code(r.value) : cell(r.automatic)) + " | " + cell(r.range) +
           " | " + cell(r.unit) + " | " + cell(r.help) + " |\n";
  return out;
}

}  // namespace satsurf

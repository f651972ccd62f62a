// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"

namespace satsurf {
namespace {

constexpr std::size_t kMostText = 4096, kEnd = 1024;  // bytes; hints stand at the end

/// Whether a byte continues a character of UTF-8.
bool continues(char c) { return (static_cast<unsigned char>(c) & 0xC0U) == 0x80U; }

/// Whether a byte behind 0xC2 makes one of the controls U+0080 to U+009F, and is its number: U+009B
/// is to some terminals what ESC [ is.
bool is_second_of_control(char c) { return (static_cast<unsigned char>(c) & 0xE0U) == 0x80U; }

std::string one_line(const std::string& text) {
  constexpr char kHex[] = "0123456789abcdef";
  std::string out;
  const auto escape = [&](unsigned char byte) {
    out += {'\\', 'x', kHex[byte / 16], kHex[byte % 16]};
  };
  for (std::size_t i = 0; i < text.size(); ++i) {
    const char c = text[i];
    const auto byte = static_cast<unsigned char>(c);
    if (c == '\n')
      out += "\\n";
    else if (c == '\r')
      out += "\\r";
    else if (c == '\t')
      out += "\\t";
    else if (byte < 0x20 || byte == 0x7F)
      escape(byte);
    else if (byte == 0xC2 && i + 1 < text.size() && is_second_of_control(text[i + 1]))
      escape(static_cast<unsigned char>(text[++i]));
    else
      out += c;
  }
  if (out.size() <= kMostText) return out;
  std::size_t begin = kMostText - kEnd, end = out.size() - kEnd;
  while (begin > 0 && continues(out[begin])) --begin;
  while (end < out.size() && continues(out[end])) ++end;
  return out.substr(0, begin) + " ... " + out.substr(end);
}

}  // namespace

Error::Error(const std::string& text) : std::runtime_error(one_line(text)) {}

}  // namespace satsurf

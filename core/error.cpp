// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/error.h"

namespace satsurf {
namespace {

constexpr std::size_t kMostText = 4096, kEnd = 1024;  // bytes; hints stand at the end

/// Whether a byte continues a character of UTF-8.
bool continues(char c) { return (static_cast<unsigned char>(c) & 0xC0U) == 0x80U; }

std::string one_line(const std::string& text) {
  constexpr char kHex[] = "0123456789abcdef";
  std::string out;
  for (const char c : text) {
    const auto byte = static_cast<unsigned char>(c);
    if (c == '\n')
      out += "\\n";
    else if (c == '\r')
      out += "\\r";
    else if (c == '\t')
      out += "\\t";
    else if (byte < 0x20 || byte == 0x7F)
      out += {'\\', 'x', kHex[byte / 16], kHex[byte % 16]};
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

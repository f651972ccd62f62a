// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/memory.h"

#include "satsurf/core/error.h"
#include "satsurf/core/memory_limits.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <charconv>
#include <cstdio>
#include <fstream>
#include <utility>

namespace satsurf {
namespace {

std::uint64_t system_memory_left() {
  std::ifstream in("/proc/meminfo");
  for (std::string line; std::getline(in, line);) {
    unsigned long long kib = 0;
    if (std::sscanf(line.c_str(), "MemAvailable: %llu kB", &kib) == 1) return kib * 1024;
  }
  return kUnlimited;
}

}  // namespace

std::uint64_t available_memory() {
  return std::min({system_memory_left(), addresses_left(),
                   group_memory_left("/proc/self/cgroup", "/sys/fs/cgroup")});
}

std::string memory_text(double bytes) {
  char text[40];
  std::snprintf(text, sizeof text, bytes < 1e8 ? "%.0f MB" : "%.1f GB",
                bytes < 1e8 ? bytes / 1e6 : bytes / 1e9);
  return text;
}

void check_memory(const std::string& what, double bytes, const std::string& hint, double held) {
  const auto available = static_cast<double>(available_memory());
  if (bytes - held <= available) return;
  throw Error(what + " about " + memory_text(bytes) + " of memory, expected " +
              memory_text(available) + " at most; " + hint);
}

double memory_from_text(const std::string& text, const std::string& where) {
  constexpr std::array<std::pair<const char*, double>, 9> kUnits{{{"", 1},
                                                                  {"b", 1},
                                                                  {"kb", 1e3},
                                                                  {"mb", 1e6},
                                                                  {"gb", 1e9},
                                                                  {"tb", 1e12},
                                                                  {"mib", 1048576},
                                                                  {"gib", 1073741824},
                                                                  {"tib", 1099511627776}}};
  double number = 0;
  const char* end = text.data() + text.size();
  const auto [rest, error] = std::from_chars(text.data(), end, number);
  std::string unit;
  for (const char* c = rest; c != end; ++c)
    if (*c != ' ') unit += static_cast<char>(std::tolower(static_cast<unsigned char>(*c)));
  const auto found = std::ranges::find_if(kUnits, [&](const auto& u) { return unit == u.first; });
  if (error != std::errc() || found == kUnits.end() || !(number * found->second >= 1e6) ||
      !(number * found->second < 1e18))
    throw ConfigError(where + ": '" + text +
                      "', expected a size of memory of 1 MB or more, e.g. 4GB");
  return number * found->second;
}

}  // namespace satsurf

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/memory.h"

#include <cstdio>
#include <fstream>
#include <limits>

namespace satsurf {

std::uint64_t available_memory() {
  std::ifstream in("/proc/meminfo");
  for (std::string line; std::getline(in, line);) {
    unsigned long long kib = 0;
    if (std::sscanf(line.c_str(), "MemAvailable: %llu kB", &kib) == 1) return kib * 1024;
  }
  return std::numeric_limits<std::uint64_t>::max();
}

std::string memory_text(double bytes) {
  char text[40];
  std::snprintf(text, sizeof text, bytes < 1e8 ? "%.0f MB" : "%.1f GB",
                bytes < 1e8 ? bytes / 1e6 : bytes / 1e9);
  return text;
}

}  // namespace satsurf

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/memory_limits.h"

#include <algorithm>
#include <fstream>
#include <string>

#include <sys/resource.h>
#include <unistd.h>

namespace satsurf {
namespace {

namespace fs = std::filesystem;

/// Names of the same numbers in both versions of control groups.
struct GroupFiles {
  const char *limit, *used, *given_back;
};

constexpr GroupFiles kVersion1{"memory.limit_in_bytes", "memory.usage_in_bytes",
                               "total_inactive_file"},
    kVersion2{"memory.max", "memory.current", "inactive_file"};

/// The first number of a file; something else where it holds none ("max", say).
std::uint64_t number_of(const fs::path& file, std::uint64_t otherwise) {
  std::ifstream in(file);
  std::uint64_t number = 0;
  return in >> number ? number : otherwise;
}

/// Of `memory.stat`; 0 where it does not name it.
std::uint64_t statistic(const fs::path& folder, const std::string& wanted) {
  std::ifstream in(folder / "memory.stat");
  std::string name;
  for (std::uint64_t number = 0; in >> name >> number;)
    if (name == wanted) return number;
  return 0;
}

std::uint64_t left_of(const fs::path& folder, const GroupFiles& files) {
  const std::uint64_t limit = number_of(folder / files.limit, kUnlimited);
  if (limit == kUnlimited) return kUnlimited;
  const std::uint64_t used = number_of(folder / files.used, 0),
                      kept = used - std::min(used, statistic(folder, files.given_back));
  return limit - std::min(limit, kept);
}

/// The least of a group and all that it lies in. A container sees its own group as the root.
std::uint64_t least_left(const fs::path& hierarchy, const std::string& group,
                         const GroupFiles& files) {
  std::uint64_t least = left_of(hierarchy, files);
  fs::path folder = hierarchy;
  for (const fs::path& part : fs::path(group).relative_path())
    least = std::min(least, left_of(folder /= part, files));
  return least;
}

}  // namespace

std::uint64_t addresses_left() {
  rlimit limit{};
  if (getrlimit(RLIMIT_AS, &limit) != 0 || limit.rlim_cur == RLIM_INFINITY) return kUnlimited;
  const std::uint64_t taken =
      number_of("/proc/self/statm", 0) * static_cast<std::uint64_t>(sysconf(_SC_PAGESIZE));
  return limit.rlim_cur - std::min<std::uint64_t>(limit.rlim_cur, taken);
}

std::uint64_t group_memory_left(const fs::path& groups, const fs::path& root) {
  std::uint64_t least = kUnlimited;
  std::ifstream in(groups);
  for (std::string line; std::getline(in, line);) {  // NUMBER:CONTROLLERS:GROUP
    const auto first = line.find(':'), second = line.find(':', first + 1);
    if (second == std::string::npos) continue;
    const std::string controllers = ',' + line.substr(first + 1, second - first - 1) + ',',
                      group = line.substr(second + 1);
    if (controllers == ",,") least = std::min(least, least_left(root, group, kVersion2));
    if (controllers.find(",memory,") != std::string::npos)
      least = std::min(least, least_left(root / "memory", group, kVersion1));
  }
  return least;
}

}  // namespace satsurf

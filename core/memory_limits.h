// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <limits>

namespace satsurf {

constexpr std::uint64_t kUnlimited = std::numeric_limits<std::uint64_t>::max();

/// Bytes of addresses that the process may still take (`ulimit -v`); `kUnlimited` without a limit.
std::uint64_t addresses_left();

/// Bytes that the control groups of the process still give, as in a container with a limit;
/// `kUnlimited` without one. Pages of files that the kernel would give back count as free.
/// groups  a text like /proc/self/cgroup
/// root    where version 2 is mounted, and in its folder `memory` version 1
std::uint64_t group_memory_left(const std::filesystem::path& groups,
                                const std::filesystem::path& root);

}  // namespace satsurf

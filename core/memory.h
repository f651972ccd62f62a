// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <string>

namespace satsurf {

/// Bytes the system says it can still give without swapping (`MemAvailable` of /proc/meminfo); the
/// largest number where it does not say.
std::uint64_t available_memory();

/// `1.5 GB`, with GB = 1e9 bytes; below 0.1 GB in MB.
std::string memory_text(double bytes);

}  // namespace satsurf

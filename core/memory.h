// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <string>

namespace satsurf {

/// Bytes that the process can still take: what the system gives without swapping (`MemAvailable` of
/// /proc/meminfo), what the limit of a container or other control group leaves, and what `ulimit -v`
/// does, whichever is least; the largest number where none is known.
std::uint64_t available_memory();

/// `1.5 GB`, with GB = 1e9 bytes; below 0.1 GB in MB.
std::string memory_text(double bytes);

/// Says no to what would not fit.
/// what    begins the error text: who needs it, and a verb
/// bytes   needed; those of `held` are taken already
/// hint    ends it: how to need less
/// throws  Error for more than `available_memory`
void check_memory(const std::string& what, double bytes, const std::string& hint, double held = 0);

/// The inverse of `memory_text`: "4GB", "4 GB", "1.5e9", "512MB", "2GiB"; bytes without a unit.
/// where   begins the error text
/// throws  ConfigError for anything else, and below 1 MB
double memory_from_text(const std::string& text, const std::string& where);

}  // namespace satsurf

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdlib>
#include <filesystem>
#include <string>

namespace satsurf::test {

/// The folder of the tests' sources.
inline std::filesystem::path tests_folder() {
  return std::filesystem::path(__FILE__).parent_path();
}

/// Real data and published weights, which the repository does not contain: SATSURF_DATA, or
/// ../shared/data beside the sources. It need not exist.
inline std::filesystem::path shared_data() {
  const char* named = std::getenv("SATSURF_DATA");
  return named ? std::filesystem::path(named) : tests_folder() / "../../shared/data";
}

}  // namespace satsurf::test

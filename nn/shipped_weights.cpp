// SPDX-License-Identifier: Apache-2.0
#include "satsurf/nn/shipped_weights.h"

#include "satsurf/core/error.h"

#include <cstdlib>
#include <system_error>

namespace satsurf::nn {

namespace fs = std::filesystem;

fs::path shipped_weights(ShippedNetwork network, const std::string& hint, const fs::path& folder) {
  const bool cascade = network == ShippedNetwork::cascade;
  if (const char* named = std::getenv("SATSURF_WEIGHTS");
      cascade && named != nullptr && *named != '\0')
    return named;
  std::error_code ignored;
  const fs::path program = fs::read_symlink("/proc/self/exe", ignored).parent_path();
  const fs::path sources = program.parent_path().parent_path().parent_path();
  std::string looked;
  for (const fs::path& place : {program.parent_path() / "share/satsurf", sources / "nn/weights",
                                folder, fs::path(SATSURF_INSTALLED_WEIGHTS)}) {
    if (place.empty()) continue;
    const fs::path file = place / (cascade ? "wide8.safetensors" : "mono12.safetensors");
    if (fs::exists(file)) return file;
    looked += (looked.empty() ? "" : ", ") + file.string();
  }
  throw IoError(std::string(cascade ? "weights" : "monocular weights") +
                ": none found, expected one of " + looked + "; " + hint);
}

}  // namespace satsurf::nn

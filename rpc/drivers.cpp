// SPDX-License-Identifier: Apache-2.0
#include "satsurf/rpc/drivers.h"

#include <cstdlib>
#include <sstream>
#include <utility>

namespace satsurf::rpc {
namespace {

std::vector<std::string>& named() {
  static std::vector<std::string> names;
  return names;
}

}  // namespace

void trust_drivers(std::vector<std::string> names) { named() = std::move(names); }

std::vector<std::string> trusted_drivers() {
  std::vector<std::string> names = named();
  if (const char* more = std::getenv("SATSURF_GDAL_DRIVERS")) {
    std::istringstream in(more);
    for (std::string name; std::getline(in, name, ',');)
      if (!name.empty()) names.push_back(name);
  }
  return names;
}

}  // namespace satsurf::rpc

// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

namespace satsurf::rpc {

/// Names further drivers of GDAL that may open files: the list that each reader knows leaves out
/// those that ask a server or a database, and the many whose code sees few files, as whoever sends
/// a file does not choose what reads it. To be called before anything is read. The others are not even
/// registered, as a file may name more files, which GDAL opens with any driver there is; where a
/// program registered some before anything was read here, it keeps those.
/// throws  ConfigError for a name that no driver of this GDAL has, here or in the environment
void trust_drivers(std::vector<std::string> names);
/// Those, and what SATSURF_GDAL_DRIVERS in the environment names, with commas between.
std::vector<std::string> trusted_drivers();

}  // namespace satsurf::rpc

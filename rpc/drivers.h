// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

namespace satsurf::rpc {

/// Names further drivers of GDAL that may open files: the list that each reader knows leaves out
/// those that ask a server or a database, and the many whose code sees few files, as whoever sends
/// a file does not choose what reads it. To be called before anything is read.
void trust_drivers(std::vector<std::string> names);
/// Those, and what SATSURF_GDAL_DRIVERS in the environment names, with commas between.
std::vector<std::string> trusted_drivers();

}  // namespace satsurf::rpc

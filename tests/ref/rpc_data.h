// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/rpc/model.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <functional>
#include <string>
#include <vector>

#include "tests/paths.h"
#include "tests/ref/synthetic_rpc.h"
#include <doctest/doctest.h>
#include <gdal_alg.h>
#include <nlohmann/json.hpp>

namespace satsurf::test {

/// `shared_data()` with its real images and cameras; empty, with a message, where there are none.
inline std::filesystem::path data_folder() {
  const std::filesystem::path folder = shared_data();
  if (std::filesystem::is_directory(folder / "rpc_library"))
    return std::filesystem::weakly_canonical(folder);
  MESSAGE("SKIPPED: no real data at ", folder.string(), " (set SATSURF_DATA)");
  return {};
}

/// The layout used by the Python package rpcm.
inline rpc::Rpc rpc_from_json(const nlohmann::json& j) {
  rpc::Rpc r;
  r.line_off = j.at("row_offset"), r.line_scale = j.at("row_scale");
  r.samp_off = j.at("col_offset"), r.samp_scale = j.at("col_scale");
  r.lat_off = j.at("lat_offset"), r.lat_scale = j.at("lat_scale");
  r.lon_off = j.at("lon_offset"), r.lon_scale = j.at("lon_scale");
  r.height_off = j.at("alt_offset"), r.height_scale = j.at("alt_scale");
  r.line_num = j.at("row_num"), r.line_den = j.at("row_den");
  r.samp_num = j.at("col_num"), r.samp_den = j.at("col_den");
  return r;
}

struct NamedRpc {
  std::string name;
  rpc::Rpc rpc;
};

/// Every camera of rpc_library whose file name begins with `prefix`.
inline std::vector<NamedRpc> library(const std::filesystem::path& data,
                                     const std::string& prefix = "") {
  std::vector<std::filesystem::path> files;
  for (const auto& entry : std::filesystem::directory_iterator(data / "rpc_library"))
    if (entry.path().filename().string().starts_with(prefix)) files.push_back(entry.path());
  std::sort(files.begin(), files.end());
  std::vector<NamedRpc> out;
  const std::function<void(const std::string&, const nlohmann::json&)> collect =
      [&](const std::string& name, const nlohmann::json& j) {
        if (j.contains("row_offset")) return out.push_back({name, rpc_from_json(j)});
        for (const auto& [key, entry] : j.items()) collect(name + "/" + key, entry);
      };
  for (const auto& file : files)
    collect(file.stem().string(), nlohmann::json::parse(std::ifstream(file)));
  return out;
}

inline GDALRPCInfoV2 gdal_info(const rpc::Rpc& r) {
  GDALRPCInfoV2 g{};
  g.dfLINE_OFF = r.line_off, g.dfLINE_SCALE = r.line_scale;
  g.dfSAMP_OFF = r.samp_off, g.dfSAMP_SCALE = r.samp_scale;
  g.dfLAT_OFF = r.lat_off, g.dfLAT_SCALE = r.lat_scale;
  g.dfLONG_OFF = r.lon_off, g.dfLONG_SCALE = r.lon_scale;
  g.dfHEIGHT_OFF = r.height_off, g.dfHEIGHT_SCALE = r.height_scale;
  std::copy(r.line_num.begin(), r.line_num.end(), g.adfLINE_NUM_COEFF);
  std::copy(r.line_den.begin(), r.line_den.end(), g.adfLINE_DEN_COEFF);
  std::copy(r.samp_num.begin(), r.samp_num.end(), g.adfSAMP_NUM_COEFF);
  std::copy(r.samp_den.begin(), r.samp_den.end(), g.adfSAMP_DEN_COEFF);
  g.dfMIN_LONG = -180, g.dfMIN_LAT = -90, g.dfMAX_LONG = 180, g.dfMAX_LAT = 90;
  return g;
}

/// GDAL's RPC transformer, brought to our pixel origin (GDAL's is the corner of the first pixel).
class GdalRpc {
 public:
  explicit GdalRpc(const rpc::Rpc& r) {
    const GDALRPCInfoV2 info = gdal_info(r);
    handle_ = GDALCreateRPCTransformerV2(&info, FALSE, 1e-4, nullptr);
    REQUIRE(handle_ != nullptr);
  }
  ~GdalRpc() { GDALDestroyRPCTransformer(handle_); }
  GdalRpc(const GdalRpc&) = delete;
  GdalRpc& operator=(const GdalRpc&) = delete;

  rpc::Pixel project(const rpc::Geodetic& p) const {
    double x = p.lon, y = p.lat, z = p.h;
    int ok = 0;
    REQUIRE(GDALRPCTransform(handle_, TRUE, 1, &x, &y, &z, &ok));
    REQUIRE(ok);
    return {x - 0.5, y - 0.5};
  }

 private:
  void* handle_ = nullptr;
};

}  // namespace satsurf::test

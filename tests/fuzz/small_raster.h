// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/core/tensor.h"

#include <algorithm>
#include <memory>
#include <string>

#include "tests/fuzz/fuzz.h"
#include <gdal_priv.h>

namespace satsurf::fuzz {

/// Writes a GeoTIFF of 8 x 8 bytes, without camera or place, into this process's folder.
/// returns  its path
inline std::filesystem::path small_raster(const std::string& name) {
  constexpr int kSide = 8;
  GDALAllRegister();
  const auto path = folder().path() / name;
  std::filesystem::create_directories(path.parent_path());
  auto* driver = GetGDALDriverManager()->GetDriverByName("GTiff");
  GDALDataset* d = driver->Create(path.c_str(), kSide, kSide, 1, GDT_Byte, nullptr);
  std::uint8_t values[kSide * kSide];
  for (int i = 0; i < kSide * kSide; ++i) values[i] = static_cast<std::uint8_t>(1 + i * 37 % 200);
  const bool written = d->GetRasterBand(1)->RasterIO(GF_Write, 0, 0, kSide, kSide, values, kSide,
                                                     kSide, GDT_Byte, 0, 0, nullptr) == CE_None;
  GDALClose(d);
  if (!written) finding("the raster beside the input could not be written");
  return path;
}

}  // namespace satsurf::fuzz

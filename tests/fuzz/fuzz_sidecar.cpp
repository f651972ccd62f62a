// SPDX-License-Identifier: Apache-2.0
// What lies beside an image: its camera in the names and forms in which vendors deliver it, its place, its metadata. Some of it
// GDAL reads, some of it we.
#include "satsurf/rpc/read.h"

#include "tests/fuzz/fuzz.h"
#include "tests/fuzz/small_raster.h"

namespace satsurf::fuzz {

constexpr const char* kNames[] = {
    "IMG_a.RPB",         "IMG_a.XML", "IMG_a_RPC.TXT", "IMG_a_rpc.txt",
    "IMG_a.rpc",         "RPC_a.XML", "DIM_a.XML",     "IMG_a.IMD",
    "IMG_a.tif.aux.xml", "IMG_a.tfw", "IMG_a.tif.msk", "IMG_a.tif.ovr",
    "a_metadata.txt",    "IMG_a.prj", "summary.txt",   "IMG_a_metadata.xml"};

void run(std::string_view bytes) {
  static const auto image = small_raster("sidecar/IMG_a.tif");
  Bytes in(bytes);
  const auto beside = folder().put(
      std::string("sidecar/") + kNames[in.take<std::uint8_t>() % std::size(kNames)], in.rest());
  only<IoError>([&] { rpc::read_info(image); });
  only<IoError>([&] { rpc::open_view(image); });
  std::error_code ignored;
  std::filesystem::remove(beside, ignored);
}

}  // namespace satsurf::fuzz

// SPDX-License-Identifier: Apache-2.0
// What JPEG 2000 and BMP files say of themselves, which GDAL would take memory for.
#include "satsurf/core/error.h"
#include "satsurf/rpc/gdal.h"
#include "satsurf/rpc/read.h"

#include <cstdint>
#include <string>

#include "tests/temp_folder.h"
#include <doctest/doctest.h>

using namespace satsurf;
using namespace satsurf::rpc;
using test::error_of;
using test::TempFolder;
using test::write_bytes;

namespace {

void append(std::string& bytes, std::uint32_t value, int size) {
  for (int k = size - 1; k >= 0; --k) bytes += static_cast<char>(value >> (8 * k) & 255);
}

/// The beginning of a code stream, up to the sizes of image and tiles.
std::string code_stream(std::uint32_t width, std::uint32_t height, std::uint32_t tile,
                        std::uint32_t bands) {
  std::string bytes = "\xff\x4f\xff\x51";
  append(bytes, 38 + 3 * bands, 2);
  append(bytes, 0, 2);
  for (const std::uint32_t n : {width, height, 0U, 0U, tile, tile, 0U, 0U}) append(bytes, n, 4);
  append(bytes, bands, 2);
  for (std::uint32_t b = 0; b < bands; ++b) bytes += "\x07\x01\x01";
  return bytes;
}

/// In boxes, as most files have it.
std::string in_boxes(const std::string& stream) {
  std::string bytes("\0\0\0\x0cjP  \r\n\x87\n", 12);
  bytes += std::string(
      "\0\0\0\x14"
      "ftypjp2 \0\0\0\0jp2 ",
      20);
  append(bytes, static_cast<std::uint32_t>(stream.size()) + 8, 4);
  return bytes + "jp2c" + stream;
}

/// A raster of a format that GDAL writes, 8 x 8 px of one band.
void plain_raster(const char* format, const std::filesystem::path& path) {
  const GdalScope scope;
  auto& memory = *GetGDALDriverManager()->GetDriverByName("MEM");
  auto* driver = GetGDALDriverManager()->GetDriverByName(format);
  REQUIRE(driver != nullptr);
  const DatasetPtr from(memory.Create("", 8, 8, 1, GDT_Byte, nullptr));
  const DatasetPtr made(
      driver->CreateCopy(path.c_str(), from.get(), false, nullptr, nullptr, nullptr));
  REQUIRE(made);
}

}  // namespace

TEST_CASE("tiles of JPEG 2000 are no more than their file is worth") {
  const TempFolder folder("tiles");
  const std::string path = (folder / "a.jp2").string();
  const auto claim = [&](const std::string& bytes) {
    write_bytes(path, bytes);
    return claim_of(path);
  };
  // 8500 bytes of a tile and 1100 of each of its bands, in OpenJPEG and in each thread; 64 MB may be
  CHECK(claim(code_stream(64, 64, 64, 1)).threads == 6665);
  CHECK(claim(code_stream(16'000, 16, 8, 1)).refusal ==
        "4000 tiles of 1 band in a file of 45 bytes take 77 MB, expected at most 64 MB");
  // 2000 tiles are 19 MB, in OpenJPEG and in two threads
  CHECK(claim(code_stream(16'000, 8, 8, 1)).threads == 2);
  CHECK(claim(code_stream(16'000, 8, 8, 12)).refusal ==
        "2000 tiles of 12 bands in a file of 78 bytes take 87 MB, expected at most 64 MB");
  CHECK(
      claim(in_boxes(code_stream(65'535, 1, 1, 3))).refusal.starts_with("65535 tiles of 3 bands"));
  CHECK(claim(code_stream(16'000, 16, 8, 1) + std::string(1'000'000, '\0')).threads == 1);
  // what OpenJPEG refuses by itself
  for (const std::string& none :
       {code_stream(65'536, 1, 1, 1), code_stream(0, 1, 1, 1), code_stream(9, 9, 0, 1),
        in_boxes("").substr(0, 32), std::string("\xff\x4f\xff\x51")}) {
    const FileClaim found = claim(none);
    CHECK(found.refusal.empty());
    CHECK(!found.threads);
  }
  write_bytes(path, code_stream(65'535, 1, 1, 1));
  const std::string refusal =
      "65535 tiles of 1 band in a file of 45 bytes take 1.3 GB, expected at most 64 MB";
  CHECK(error_of<IoError>([&] { read_info(path); }) == path + ": " + refusal);
  // the same where another file names it, and a driver opens it by itself
  const std::string product = (folder / "dim.xml").string();
  write_bytes(
      product,
      R"(<Dimap_Document><Metadata_Id><METADATA_FORMAT version="1.1">DIMAP</METADATA_FORMAT></Metadata_Id>)"
      R"(<Raster_Dimensions><NCOLS>4</NCOLS><NROWS>4</NROWS><NBANDS>1</NBANDS></Raster_Dimensions>)"
      R"(<Data_Access><Data_File><DATA_FILE_PATH href="a.jp2"/></Data_File></Data_Access></Dimap_Document>)");
  CHECK(error_of<IoError>([&] { read_image(product); }) ==
        product + ": \"" + path + "\", which belongs to it: " + refusal);
}

TEST_CASE("threads that a JPEG 2000 file allows hold while it is read, and not longer") {
  const TempFolder folder("threads");
  write_bytes(folder / "a.jp2", code_stream(16'000, 8, 8, 1));
  const char* const kName = "GDAL_NUM_THREADS";
  CPLSetThreadLocalConfigOption(kName, "7");
  {
    const GdalScope scope;
    CHECK_THROWS_AS(open_raster(folder / "a.jp2"), IoError);  // it ends behind its sizes
    CHECK(std::string(CPLGetConfigOption(kName, "")) == "2");
  }
  CHECK(std::string(CPLGetConfigOption(kName, "")) == "7");
  CPLSetThreadLocalConfigOption(kName, nullptr);
}

TEST_CASE("a whole JPEG 2000 file is read with as many threads as there are") {
  const TempFolder folder("whole");
  plain_raster("JP2OpenJPEG", folder / "a.jp2");
  CHECK(read_image(folder / "a.jp2").pixels.dim(2) == 8);
  CHECK(claim_of((folder / "a.jp2").string()).threads > 1000);
}

TEST_CASE("a BMP has as many pixels as its file can hold") {
  const TempFolder folder("bmp");
  const std::string path = (folder / "a.bmp").string();
  plain_raster("BMP", path);
  CHECK(read_image(path).pixels.dim(2) == 8);
  const auto claim = [&](const std::string& sizes) {
    std::string bytes = "BM" + std::string(12, '\0') + sizes;
    write_bytes(path, bytes + std::string(104 - bytes.size(), '\0'));
    return claim_of(path).refusal;
  };
  CHECK(claim(std::string("\x28\0\0\0\x08\0\0\1\x2b\0\0\0\1\0\x18\0\1", 17)) ==
        "16777224 x 43 px in a file of 104 bytes, expected at least a byte for every 20000; "
        "damaged?");
  CHECK(claim(std::string("\x28\0\0\0\0\x10\0\0\0\xf0\xff\xff", 12)).empty());  // 4096 rows, down
  CHECK(claim(std::string("\x28\0\0\0\0\x20\0\0\0\xe0\xff\xff", 12))
            .starts_with("8192 x 8192 px in a file of 104 bytes"));
  CHECK(claim(std::string("\x0c\0\0\0\xff\xff\xff\xff\1\0\x18\0", 12))
            .starts_with("65535 x 65535 px"));
  CHECK(claim(std::string("\x0c\0\0\0\0\1\0\1\1\0\x18\0", 12)).empty());
  write_bytes(path, "BM");
  CHECK(claim_of(path).refusal.empty());
}

// SPDX-License-Identifier: Apache-2.0
#include "satsurf/rpc/picture.h"

#include "satsurf/core/error.h"
#include "satsurf/core/files.h"
#include "satsurf/core/memory.h"
#include "satsurf/rpc/gdal.h"

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdlib>
#include <fstream>
#include <string>
#include <vector>

namespace satsurf::rpc {
namespace {

/// Whether a PNG ends before its last chunk. GDAL reads the rows and asks for nothing behind them, so
/// it would not miss a checksum or the end.
bool is_truncated_png(const std::filesystem::path& path) {
  std::ifstream in(path, std::ios::binary);
  in.seekg(8);  // the signature
  std::array<char, 8> head{};
  while (in.read(head.data(), 8)) {  // length and name, then the chunk and its checksum
    if (std::string(head.data() + 4, 4) == "IEND") return false;
    std::uint32_t length = 0;
    for (std::size_t i = 0; i < 4; ++i) length = length << 8 | static_cast<unsigned char>(head[i]);
    in.seekg(static_cast<std::streamoff>(length) + 4, std::ios::cur);
  }
  return true;
}

/// A 16-bit number, the larger half first.
Index number16(const unsigned char* at) { return at[0] << 8 | at[1]; }

struct PictureSize {
  Index width = 0, height = 0, channels = 0;
};

/// The size that a JPEG's frame header names (ITU-T T.81 B.2.2), zeros if there is none. libjpeg,
/// told to open a progressive one, takes memory for all of it before its size can be asked.
PictureSize jpeg_size(const std::filesystem::path& path) {
  std::ifstream in(path, std::ios::binary);
  int byte = in.get();
  while (in) {
    if (byte != 0xff) {  // as libjpeg does: what is no marker is passed over
      byte = in.get();
      continue;
    }
    while (byte == 0xff) byte = in.get();
    const int marker = byte;
    byte = in.get();
    const bool stands_alone = marker <= 0x01 || (marker >= 0xd0 && marker <= 0xd9);
    if (stands_alone || !in) continue;
    // What follows the first byte of the length: its second, precision, height, width, channels.
    std::array<unsigned char, 7> rest{};
    if (!in.read(reinterpret_cast<char*>(rest.data()), 1)) break;
    const std::streamoff length = byte << 8 | rest[0];
    const bool is_frame =
        marker >= 0xc0 && marker <= 0xcf && marker != 0xc4 && marker != 0xc8 && marker != 0xcc;
    if (!is_frame) {
      in.seekg(std::max<std::streamoff>(length - 2, 0), std::ios::cur);
      byte = in.get();
      continue;
    }
    if (!in.read(reinterpret_cast<char*>(rest.data()) + 1, 6)) break;
    return {number16(&rest[4]), number16(&rest[2]), rest[6]};
  }
  return {};
}

/// Whether all colours of a palette are grey: GDAL gives one to pictures whose white is zero, too.
bool is_grey(const GDALColorTable& palette) {
  for (int i = 0; i < palette.GetColorEntryCount(); ++i) {
    const GDALColorEntry& entry = *palette.GetColorEntry(i);
    if (entry.c1 != entry.c2 || entry.c2 != entry.c3) return false;
  }
  return true;
}

/// Indices as the colours they stand for.
/// index    [1 H W]
/// returns  [3 H W], or [1 H W] where all are grey
Tensor coloured(const Tensor& index, const GDALColorTable& palette) {
  const Index C = is_grey(palette) ? 1 : 3, H = index.dim(1), W = index.dim(2), P = H * W;
  Tensor out({C, H, W});
  for (Index i = 0; i < P; ++i) {
    const GDALColorEntry* entry = palette.GetColorEntry(static_cast<int>(index[i]));
    if (entry == nullptr) continue;  // black, as an index beyond the last
    const std::array<short, 3> colour{entry->c1, entry->c2, entry->c3};
    for (Index c = 0; c < C; ++c)
      out[c * P + i] = static_cast<float>(colour[static_cast<std::size_t>(c)]) / 255;
  }
  return out;
}

/// Values as shares of the largest that their type has.
/// of  one of the bands they come from
Tensor scaled(Tensor values, GDALRasterBand& of) {
  const GDALDataType type = of.GetRasterDataType();
  if (type != GDT_Byte && type != GDT_UInt16) return values;
  const char* bits = of.GetMetadataItem("NBITS", "IMAGE_STRUCTURE");
  const int n =
      bits == nullptr ? 8 * GDALGetDataTypeSizeBytes(type) : std::clamp(std::atoi(bits), 1, 16);
  const auto most = static_cast<float>((1 << n) - 1);
  for (float& v : values.values()) v /= most;
  return values;
}

}  // namespace

Tensor read_picture(const std::filesystem::path& path) {
  const std::string where = path.string();
  const auto refuse = [&](const std::string& what) {
    throw IoError(where + ": " + what + ", expected a PNG, JPEG or TIFF picture");
  };
  require_file(path, "a PNG, JPEG or TIFF picture");
  std::error_code ec;
  const std::uintmax_t bytes = std::filesystem::file_size(path, ec);
  const auto described = [](const PictureSize& of) {
    return std::to_string(of.width) + " x " + std::to_string(of.height) + " px with " +
           std::to_string(of.channels) + " channels";
  };
  // A flat PNG packs a thousand values into a byte, and only one of a single bit more than these. What
  // needs little memory is not worth a refusal.
  const auto check_packing = [&](const PictureSize& of) {
    constexpr double kLittle = 16e6, kMostValues = 1e4;
    const double values = static_cast<double>(of.channels) * static_cast<double>(of.height) *
                          static_cast<double>(of.width);
    if (values > kLittle && !ec && values > kMostValues * static_cast<double>(bytes))
      refuse(described(of) + " in a file of " + std::to_string(bytes) + " bytes");
  };
  const GdalScope scope;
  // Of the many that there are: whoever sends a picture does not choose.
  constexpr std::array<const char*, 4> kDrivers{"PNG", "JPEG", "GTiff", nullptr};
  constexpr std::array<const char*, 1> kAlone{nullptr};  // no file beside it says anything of it
  const GDALDriverH format =
      GDALIdentifyDriverEx(where.c_str(), GDAL_OF_RASTER, kDrivers.data(), kAlone.data());
  if (format == nullptr) refuse("of another format");
  const std::string driver = GDALGetDriverShortName(format);
  if (driver == "PNG" && is_truncated_png(path)) refuse("the file ends too early");
  if (driver == "JPEG") check_packing(jpeg_size(path));
  // else the rest of a JPEG that was cut off is grey
  const CPLConfigOptionSetter strict("GDAL_ERROR_ON_LIBJPEG_WARNING", "YES", true);
  const DatasetPtr d(GDALDataset::Open(where.c_str(), GDAL_OF_RASTER | GDAL_OF_VERBOSE_ERROR,
                                       kDrivers.data(), nullptr, kAlone.data()));
  check_refused(path);
  if (!d) refuse(gdal_error());
  const PictureSize size{d->GetRasterXSize(), d->GetRasterYSize(), d->GetRasterCount()};
  if (size.channels < 1 || size.channels > 4) refuse(described(size));
  check_packing(size);
  check_content(path, *d);
  GDALRasterBand& first = *d->GetRasterBand(1);
  const GDALColorTable* palette = size.channels == 1 ? first.GetColorTable() : nullptr;
  const Index H = size.height, W = size.width, P = H * W,
              C = palette == nullptr && size.channels < 3 ? 1 : 3,
              read = palette != nullptr ? 1 : C;
  satsurf::check_memory(where + ": " + described(size) + " need",
                        sizeof(float) * static_cast<double>((read + C) * P), "cut it");
  auto values = Tensor::uninitialised({read, H, W});
  for (Index c = 0; c < read; ++c)
    if (d->GetRasterBand(static_cast<int>(c) + 1)
            ->RasterIO(GF_Read, 0, 0, static_cast<int>(W), static_cast<int>(H),
                       values.data() + c * P, static_cast<int>(W), static_cast<int>(H), GDT_Float32,
                       0, 0, nullptr) != CE_None)
      refuse(gdal_error());
  return palette != nullptr ? coloured(values, *palette) : scaled(values, first);
}

std::string encoded_picture(const std::string& where, std::vector<std::uint8_t>& pixels,
                            Index height, Index width, Index channels, PictureFormat format) {
  const auto refuse = [&] { throw IoError(where + ": " + gdal_error()); };
  const GdalScope scope;
  GDALDriverManager& manager = *GetGDALDriverManager();
  GDALDriver *memory = manager.GetDriverByName("MEM"),
             *driver = manager.GetDriverByName(format == PictureFormat::png ? "PNG" : "JPEG");
  if (memory == nullptr || driver == nullptr)
    throw IoError(where + ": this GDAL writes no such pictures, expected its drivers PNG and JPEG");
  const int W = static_cast<int>(width), H = static_cast<int>(height),
            C = static_cast<int>(channels);
  const DatasetPtr from(memory->Create("", W, H, C, GDT_Byte, nullptr));
  if (!from || from->RasterIO(GF_Write, 0, 0, W, H, pixels.data(), W, H, GDT_Byte, C, nullptr, C,
                              static_cast<GSpacing>(C) * W, 1, nullptr) != CE_None)
    refuse();
  CPLStringList options;
  if (format == PictureFormat::png)
    options.SetNameValue("ZLEVEL", "2");  // less time than 4, and shades take fewer bytes
  else
    options.SetNameValue("QUALITY", "90");
  const MemoryFile file;
  CPLErrorReset();
  DatasetPtr made(
      driver->CreateCopy(file.name().c_str(), from.get(), FALSE, options, nullptr, nullptr));
  if (!made) refuse();
  made.reset();
  if (CPLGetLastErrorType() >= CE_Failure) refuse();
  const auto bytes = file.bytes();
  if (!bytes) refuse();
  return std::string(*bytes);
}

}  // namespace satsurf::rpc

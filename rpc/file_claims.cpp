// SPDX-License-Identifier: Apache-2.0
// What GDAL takes memory for before it has seen that a file cannot hold it.
#include "satsurf/core/memory.h"
#include "satsurf/core/whole.h"
#include "satsurf/rpc/gdal.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <fstream>
#include <iomanip>
#include <sstream>

namespace satsurf::rpc {
namespace {

/// A file's bytes, wherever they are asked for.
class Bytes {
 public:
  explicit Bytes(const std::string& name) : in_(name, std::ios::binary) {
    in_.seekg(0, std::ios::end);
    size_ = in_ ? static_cast<double>(in_.tellg()) : 0;
  }
  double size() const { return size_; }

  /// returns  false if the file ends before
  template <std::size_t N>
  bool read(double at, std::array<std::uint8_t, N>& out) {
    if (!(at >= 0 && at + N <= size_)) return false;
    in_.clear();
    in_.seekg(static_cast<std::streamoff>(at));
    return static_cast<bool>(in_.read(reinterpret_cast<char*>(out.data()), N));
  }

 private:
  std::ifstream in_;
  double size_ = 0;
};

template <std::size_t N>
double little_endian(const std::array<std::uint8_t, N>& bytes, std::size_t at) {
  return bytes[at] + 256.0 * (bytes[at + 1] + 256.0 * (bytes[at + 2] + 256.0 * bytes[at + 3]));
}

template <std::size_t N>
double big_endian(const std::array<std::uint8_t, N>& bytes, std::size_t at, std::size_t size) {
  double value = 0;
  for (std::size_t k = 0; k < size; ++k) value = 256 * value + bytes[at + k];
  return value;
}

/// Of a packed BMP GDAL makes room for all pixels as soon as it is opened.
/// returns  what is wrong, or nothing
std::string false_size(Bytes& file) {
  constexpr double kHalf = 65'536, kOld = 12;  // bytes of the header that has half as large numbers
  std::array<std::uint8_t, 12> header{};
  if (!file.read(14, header)) return "";
  const bool old = little_endian(header, 0) == kOld;
  const auto side = [&](std::size_t k) {
    if (old) return std::fmod(little_endian(header, 4 + 2 * k), kHalf);
    const double n = little_endian(header, 4 + 4 * k);
    return n < kHalf * kHalf / 2 ? n : kHalf * kHalf - n;  // below zero where rows go down
  };
  const double width = side(0), height = side(1);
  if (width * height <= most_pixels(file.size())) return "";
  std::ostringstream text;
  text << std::fixed << std::setprecision(0) << width << " x " << height << " px in a file of "
       << file.size() << " bytes, expected at least a byte for every " << kMostPacked
       << "; damaged?";
  return text.str();
}

/// Where the code stream of a JPEG 2000 file begins: at once, or in the first box that holds one.
std::optional<double> code_stream(Bytes& file) {
  constexpr int kMostBoxes = 10'000;
  std::array<std::uint8_t, 16> box{};
  double at = 0;
  if (std::array<std::uint8_t, 2> marker{}; file.read(0, marker) && marker[0] == 0xff) return 0;
  for (int i = 0; i < kMostBoxes; ++i) {
    if (!file.read(at, box)) return std::nullopt;
    const double said = big_endian(box, 0, 4);
    const bool is_long = said == 1;
    const double size = is_long ? big_endian(box, 8, 8) : said;
    if (box[4] == 'j' && box[5] == 'p' && box[6] == '2' && box[7] == 'c')
      return at + (is_long ? 16 : 8);
    if (size < 8) return std::nullopt;  // the last one, or none
    at += size;
  }
  return std::nullopt;
}

/// OpenJPEG keeps what is said of every tile, read or not, and each thread of GDAL's once more.
FileClaim claim_of_tiles(Bytes& file) {
  constexpr double kTile = 8500, kBand = 1100;  // bytes in OpenJPEG 2.5
  constexpr double kMostTiles = 65'535;         // of more OpenJPEG reads nothing
  std::array<std::uint8_t, 40> size{};          // of which the tiles follow
  const std::optional<double> start = code_stream(file);
  if (!start || !file.read(*start + 2, size) || size[0] != 0xff || size[1] != 0x51) return {};
  const auto number = [&](std::size_t k) { return big_endian(size, 6 + 4 * k, 4); };
  const auto along = [&](std::size_t k) {
    return std::ceil((number(k) - number(k + 6)) / number(k + 4));
  };
  const double bands = big_endian(size, 38, 2), tiles = along(0) * along(1);
  if (!(tiles >= 1 && tiles <= kMostTiles)) return {};
  const double once = tiles * (kTile + kBand * bands), most = most_beside(file.size());
  if (2 * once <= most) return {"", floored(std::min(most / once, 1e6)) - 1};
  std::ostringstream text;
  text << tiles << (tiles == 1 ? " tile of " : " tiles of ") << bands
       << (bands == 1 ? " band" : " bands") << " in a file of "
       << static_cast<long long>(file.size()) << " bytes take " << memory_text(2 * once)
       << ", expected at most " << memory_text(most);
  return {text.str(), 1};
}

template <std::size_t N>
bool begins(Bytes& file, const std::array<std::uint8_t, N>& with) {
  std::array<std::uint8_t, N> start{};
  return file.read(0, start) && start == with;
}

bool begins_jpeg2000(Bytes& file) {
  constexpr std::array<std::uint8_t, 12> kBoxes{0,   0,   0,    12,   'j',  'P',
                                                ' ', ' ', 0x0d, 0x0a, 0x87, 0x0a};
  constexpr std::array<std::uint8_t, 4> kCodeStream{0xff, 0x4f, 0xff, 0x51};
  return begins(file, kBoxes) || begins(file, kCodeStream);
}

}  // namespace

bool is_jpeg2000(const std::string& name) {
  Bytes file(name);
  return begins_jpeg2000(file);
}

FileClaim claim_of(const std::string& name) {
  constexpr std::array<std::uint8_t, 2> kBmp{'B', 'M'};
  Bytes file(name);
  if (begins(file, kBmp)) return {false_size(file), {}};
  if (begins_jpeg2000(file)) return claim_of_tiles(file);
  return {};
}

}  // namespace satsurf::rpc

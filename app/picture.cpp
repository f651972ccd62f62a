// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/picture.h"

#include "satsurf/core/error.h"
#include "satsurf/core/files.h"
#include "satsurf/core/memory.h"

#include <algorithm>
#include <array>
#include <cstdint>
#include <fstream>
#include <memory>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <OpenImageIO/imageio.h>

namespace satsurf::app {
namespace {

/// One line of what the library has to say.
std::string told(std::string text) {
  std::replace(text.begin(), text.end(), '\n', ' ');
  while (!text.empty() && text.back() == ' ') text.pop_back();
  return text.empty() ? "not readable" : text;
}

/// Whether a file begins as a PNG and ends before its last chunk. The library would find that out as
/// well, but libpng then writes to stderr.
bool is_truncated_png(const std::filesystem::path& path) {
  constexpr std::string_view kSignature("\x89PNG\r\n\x1a\n", 8);
  std::ifstream in(path, std::ios::binary);
  std::array<char, 8> head{};
  if (!in.read(head.data(), 8) || std::string_view(head.data(), 8) != kSignature) return false;
  while (in.read(head.data(), 8)) {  // length and name, then the chunk and its checksum
    if (std::string_view(head.data() + 4, 4) == "IEND") return false;
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

/// The format of a picture by how the file begins, as the library calls it; empty for others: of the
/// many that it reads, whoever sends a picture does not choose.
std::string format_of(const std::filesystem::path& path) {
  constexpr std::array<std::pair<std::string_view, const char*>, 6> kBeginnings{
      {{{"\x89PNG\r\n\x1a\n", 8}, "png"},
       {{"\xff\xd8\xff", 3}, "jpeg"},
       {{"II*\0", 4}, "tiff"},
       {{"MM\0*", 4}, "tiff"},
       {{"II+\0", 4}, "tiff"},
       {{"MM\0+", 4}, "tiff"}}};
  std::array<char, 8> head{};
  std::ifstream(path, std::ios::binary).read(head.data(), 8);
  const std::string_view begins(head.data(), head.size());
  const auto found = std::ranges::find_if(
      kBeginnings, [&](const auto& known) { return begins.starts_with(known.first); });
  return found == kBeginnings.end() ? std::string() : found->second;
}

}  // namespace

Tensor read_picture(const std::filesystem::path& path) {
  const std::string where = path.string();
  const auto refuse = [&](const std::string& what) {
    throw IoError(where + ": " + what + ", expected a PNG, JPEG or TIFF picture");
  };
  require_file(path, "a PNG, JPEG or TIFF picture");
  std::error_code ec;
  const std::string format = format_of(path);
  if (format.empty()) refuse("of another format");
  if (is_truncated_png(path)) refuse("the file ends too early");
  const std::uintmax_t bytes = std::filesystem::file_size(path, ec);
  const auto described = [](const PictureSize& of) {
    return std::to_string(of.width) + " x " + std::to_string(of.height) + " px with " +
           std::to_string(of.channels) + " channels";
  };
  // A flat PNG packs a thousand values into a byte, and only one of a single bit more than these. What
  // needs little memory is not worth a refusal.
  const auto check_packing = [&](const PictureSize& of) {
    constexpr double kLittle = 16e6, kMostPacked = 1e4;
    const double values = static_cast<double>(of.channels) * static_cast<double>(of.height) *
                          static_cast<double>(of.width);
    if (values > kLittle && !ec && values > kMostPacked * static_cast<double>(bytes))
      refuse(described(of) + " in a file of " + std::to_string(bytes) + " bytes");
  };
  if (format == "jpeg") check_packing(jpeg_size(path));
  OIIO::ImageSpec how;
  how.attribute("oiio:UnassociatedAlpha", 1);  // colours as stored, not multiplied by alpha
  const std::unique_ptr<OIIO::ImageInput> in = OIIO::ImageInput::create(format);
  OIIO::ImageSpec spec;
  if (!in || !in->open(where, spec, how)) refuse(told(in ? in->geterror() : OIIO::geterror()));
  const PictureSize size{spec.width, spec.height, spec.nchannels};
  if (spec.width < 1 || spec.height < 1 || spec.depth > 1 || spec.nchannels < 1 ||
      spec.nchannels > 4)
    refuse(described(size));
  check_packing(size);
  const Index C = spec.nchannels < 3 ? 1 : 3, H = spec.height, W = spec.width;
  check_memory(where + ": " + described(size) + " need",
               (C == 1 ? 1 : 2) * sizeof(float) * static_cast<double>(C * H * W), "cut it");
  // What is cut off is an error that some formats only note, with zeros for the rest.
  const auto read = [&](float* to) {
    if (!in->read_image(0, 0, 0, static_cast<int>(C), OIIO::TypeDesc::FLOAT, to) || in->has_error())
      refuse(told(in->geterror()));
  };
  auto out = Tensor::uninitialised({C, H, W});
  if (C == 1) {
    read(out.data());
    return out;
  }
  std::vector<float> pixels(static_cast<std::size_t>(C * H * W));
  read(pixels.data());
  for (Index i = 0; i < H * W; ++i)
    for (Index c = 0; c < C; ++c) out[c * H * W + i] = pixels[static_cast<std::size_t>(i * C + c)];
  return out;
}

}  // namespace satsurf::app

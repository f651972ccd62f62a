// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/picture.h"

#include "satsurf/core/error.h"
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
  std::error_code ec;
  if (!std::filesystem::is_regular_file(path, ec)) refuse("no such file");
  const std::string format = format_of(path);
  if (format.empty()) refuse("of another format");
  if (is_truncated_png(path)) refuse("the file ends too early");
  OIIO::ImageSpec how;
  how.attribute("oiio:UnassociatedAlpha", 1);  // colours as stored, not multiplied by alpha
  const std::unique_ptr<OIIO::ImageInput> in = OIIO::ImageInput::create(format);
  OIIO::ImageSpec spec;
  if (!in || !in->open(where, spec, how)) refuse(told(in ? in->geterror() : OIIO::geterror()));
  const std::string size_text = std::to_string(spec.width) + " x " + std::to_string(spec.height) +
                                " px with " + std::to_string(spec.nchannels) + " channels";
  if (spec.width < 1 || spec.height < 1 || spec.depth > 1 || spec.nchannels < 1 ||
      spec.nchannels > 4)
    refuse(size_text);
  const int read = spec.nchannels < 3 ? 1 : 3;
  const Index C = read, H = spec.height, W = spec.width;
  // A flat PNG packs a thousand pixels into a byte. What needs little memory is not worth a refusal.
  constexpr double kLittle = 16e6, kMostPacked = 1e5;
  const double values = static_cast<double>(C) * static_cast<double>(H) * static_cast<double>(W);
  const std::uintmax_t bytes = std::filesystem::file_size(path, ec);
  if (values > kLittle && !ec && values > kMostPacked * static_cast<double>(bytes))
    refuse(size_text + " in a file of " + std::to_string(bytes) + " bytes");
  check_memory(where + ": " + size_text + " need", 2 * sizeof(float) * values, "cut it");
  std::vector<float> pixels(static_cast<std::size_t>(C * H * W));
  if (!in->read_image(0, 0, 0, read, OIIO::TypeDesc::FLOAT, pixels.data()))
    refuse(told(in->geterror()));

  auto out = Tensor::uninitialised({C, H, W});
  for (Index i = 0; i < H * W; ++i)
    for (Index c = 0; c < C; ++c) out[c * H * W + i] = pixels[static_cast<std::size_t>(i * C + c)];
  return out;
}

}  // namespace satsurf::app

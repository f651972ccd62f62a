// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/legend.h"

#include "satsurf/app/svg.h"
#include "satsurf/core/atomic_file.h"
#include "satsurf/core/dims.h"
#include "satsurf/rpc/crs.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

#include <fmt/format.h>

namespace satsurf::app {
namespace {

// A font of our own: OpenImageIO draws text only where it finds a font of the system. Five columns
// of eight dots for each of the characters from space to z, the lowest bit on top.
using Glyph = std::array<std::uint8_t, 5>;
constexpr std::array<Glyph, 91> kFont{{
    {0x00, 0x00, 0x00, 0x00, 0x00}, {0x00, 0x00, 0x5F, 0x00, 0x00}, {0x00, 0x07, 0x00, 0x07, 0x00},
    {0x14, 0x7F, 0x14, 0x7F, 0x14}, {0x24, 0x2A, 0x7F, 0x2A, 0x12}, {0x23, 0x13, 0x08, 0x64, 0x62},
    {0x36, 0x49, 0x56, 0x20, 0x50}, {0x00, 0x08, 0x07, 0x03, 0x00}, {0x00, 0x1C, 0x22, 0x41, 0x00},
    {0x00, 0x41, 0x22, 0x1C, 0x00}, {0x2A, 0x1C, 0x7F, 0x1C, 0x2A}, {0x08, 0x08, 0x3E, 0x08, 0x08},
    {0x00, 0x80, 0x70, 0x30, 0x00}, {0x08, 0x08, 0x08, 0x08, 0x08}, {0x00, 0x00, 0x60, 0x60, 0x00},
    {0x20, 0x10, 0x08, 0x04, 0x02}, {0x3E, 0x51, 0x49, 0x45, 0x3E}, {0x00, 0x42, 0x7F, 0x40, 0x00},
    {0x42, 0x61, 0x51, 0x49, 0x46}, {0x21, 0x41, 0x45, 0x4B, 0x31}, {0x18, 0x14, 0x12, 0x7F, 0x10},
    {0x27, 0x45, 0x45, 0x45, 0x39}, {0x3C, 0x4A, 0x49, 0x49, 0x30}, {0x01, 0x71, 0x09, 0x05, 0x03},
    {0x36, 0x49, 0x49, 0x49, 0x36}, {0x06, 0x49, 0x49, 0x29, 0x1E}, {0x00, 0x36, 0x36, 0x00, 0x00},
    {0x00, 0x56, 0x36, 0x00, 0x00}, {0x08, 0x14, 0x22, 0x41, 0x00}, {0x14, 0x14, 0x14, 0x14, 0x14},
    {0x00, 0x41, 0x22, 0x14, 0x08}, {0x02, 0x01, 0x51, 0x09, 0x06}, {0x32, 0x49, 0x79, 0x41, 0x3E},
    {0x7E, 0x11, 0x11, 0x11, 0x7E}, {0x7F, 0x49, 0x49, 0x49, 0x36}, {0x3E, 0x41, 0x41, 0x41, 0x22},
    {0x7F, 0x41, 0x41, 0x22, 0x1C}, {0x7F, 0x49, 0x49, 0x49, 0x41}, {0x7F, 0x09, 0x09, 0x09, 0x01},
    {0x3E, 0x41, 0x49, 0x49, 0x7A}, {0x7F, 0x08, 0x08, 0x08, 0x7F}, {0x00, 0x41, 0x7F, 0x41, 0x00},
    {0x20, 0x40, 0x41, 0x3F, 0x01}, {0x7F, 0x08, 0x14, 0x22, 0x41}, {0x7F, 0x40, 0x40, 0x40, 0x40},
    {0x7F, 0x02, 0x0C, 0x02, 0x7F}, {0x7F, 0x04, 0x08, 0x10, 0x7F}, {0x3E, 0x41, 0x41, 0x41, 0x3E},
    {0x7F, 0x09, 0x09, 0x09, 0x06}, {0x3E, 0x41, 0x51, 0x21, 0x5E}, {0x7F, 0x09, 0x19, 0x29, 0x46},
    {0x46, 0x49, 0x49, 0x49, 0x31}, {0x01, 0x01, 0x7F, 0x01, 0x01}, {0x3F, 0x40, 0x40, 0x40, 0x3F},
    {0x1F, 0x20, 0x40, 0x20, 0x1F}, {0x3F, 0x40, 0x38, 0x40, 0x3F}, {0x63, 0x14, 0x08, 0x14, 0x63},
    {0x07, 0x08, 0x70, 0x08, 0x07}, {0x61, 0x51, 0x49, 0x45, 0x43}, {0x00, 0x7F, 0x41, 0x41, 0x00},
    {0x02, 0x04, 0x08, 0x10, 0x20}, {0x00, 0x41, 0x41, 0x7F, 0x00}, {0x04, 0x02, 0x01, 0x02, 0x04},
    {0x40, 0x40, 0x40, 0x40, 0x40}, {0x00, 0x01, 0x02, 0x04, 0x00}, {0x20, 0x54, 0x54, 0x54, 0x78},
    {0x7F, 0x48, 0x44, 0x44, 0x38}, {0x38, 0x44, 0x44, 0x44, 0x20}, {0x38, 0x44, 0x44, 0x48, 0x7F},
    {0x38, 0x54, 0x54, 0x54, 0x18}, {0x08, 0x7E, 0x09, 0x01, 0x02}, {0x18, 0xA4, 0xA4, 0xA4, 0x7C},
    {0x7F, 0x08, 0x04, 0x04, 0x78}, {0x00, 0x44, 0x7D, 0x40, 0x00}, {0x40, 0x80, 0x84, 0x7D, 0x00},
    {0x7F, 0x10, 0x28, 0x44, 0x00}, {0x00, 0x41, 0x7F, 0x40, 0x00}, {0x7C, 0x04, 0x18, 0x04, 0x78},
    {0x7C, 0x08, 0x04, 0x04, 0x78}, {0x38, 0x44, 0x44, 0x44, 0x38}, {0xFC, 0x24, 0x24, 0x24, 0x18},
    {0x18, 0x24, 0x24, 0x18, 0xFC}, {0x7C, 0x08, 0x04, 0x04, 0x08}, {0x48, 0x54, 0x54, 0x54, 0x20},
    {0x04, 0x3F, 0x44, 0x40, 0x20}, {0x3C, 0x40, 0x40, 0x20, 0x7C}, {0x1C, 0x20, 0x40, 0x20, 0x1C},
    {0x3C, 0x40, 0x30, 0x40, 0x3C}, {0x44, 0x28, 0x10, 0x28, 0x44}, {0x1C, 0xA0, 0xA0, 0xA0, 0x7C},
    {0x44, 0x64, 0x54, 0x4C, 0x44},
}};

using Colour = std::array<float, 3>;
constexpr Colour kInk{0, 0, 0}, kPaper{1, 1, 1};

void fill(Tensor& picture, Index x, Index y, Index width, Index height, const Colour& colour) {
  const Index H = picture.dim(1), W = picture.dim(2);
  for (std::size_t c = 0; c < 3; ++c)
    for (Index i = std::max<Index>(y, 0); i < std::min(H, y + height); ++i)
      for (Index j = std::max<Index>(x, 0); j < std::min(W, x + width); ++j)
        picture[(static_cast<Index>(c) * H + i) * W + j] = colour[c];
}

/// The colour at a share of a scale.
Colour colour_at(const ColourScale& scale, double share) {
  const auto last = static_cast<double>(scale.colours.size() - 1);
  const double at = std::clamp(share, 0.0, 1.0) * last;
  const auto low = std::min(static_cast<std::size_t>(at), scale.colours.size() - 2);
  const auto part = static_cast<float>(at - static_cast<double>(low));
  Colour out{};
  for (std::size_t c = 0; c < 3; ++c)
    out[c] = (1 - part) * scale.colours[low][c] + part * scale.colours[low + 1][c];
  return out;
}

/// A pointed end of a scale: what lies beyond has its colour, too.
/// x  of its side at the scale; it points away from there, 5 dots far
void draw_end(Tensor& picture, Index x, Index y, Index dot, bool left, const Colour& colour) {
  for (Index j = 0; j < 5 * dot; ++j) {
    const Index tall = std::max<Index>(1, 8 * (5 * dot - j) / 5);
    fill(picture, left ? x - 1 - j : x + j, y + (8 * dot - tall) / 2, 1, tall, colour);
  }
}

/// The colours of a scale, their numbers below.
/// dot  side of the text's dots, px
void draw_scale(Tensor& picture, const ColourScale& scale, Index x, Index y, Index width,
                Index dot) {
  if (scale.below) draw_end(picture, x, y, dot, true, scale.colours.front());
  if (scale.above) draw_end(picture, x + width, y, dot, false, scale.colours.back());
  for (Index j = 0; j < width; ++j)
    fill(picture, x + j, y, 1, 8 * dot,
         colour_at(scale, (static_cast<double>(j) + 0.5) / static_cast<double>(width)));
  const double span = scale.high - scale.low;
  const auto number = [](double v) { return fmt::format("{:.6g}", std::abs(v) < 1e-12 ? 0.0 : v); };
  const auto widest =
      std::max(text_width(number(scale.low), dot), text_width(number(scale.high), dot));
  double step = tick_step(1.6 * span);
  while (step < span &&
         step / span * static_cast<double>(width) < 1.3 * static_cast<double>(widest + 12 * dot))
    step *= 2;
  for (double v = std::ceil(scale.low / step - 1e-6) * step; v <= scale.high + 1e-6 * step;
       v += step) {
    const auto at =
        static_cast<Index>(std::lround((v - scale.low) / span * static_cast<double>(width - dot)));
    const std::string text = number(std::abs(v) < 1e-9 * step ? 0.0 : v);
    const Index wide = text_width(text, dot);
    fill(picture, x + at, y + 8 * dot, dot, 3 * dot, kInk);
    draw_text(picture, std::clamp(x + at - wide / 2, x, x + width - wide), y + 12 * dot, dot, text);
  }
}

/// An arrow upwards and an N, 16 x 11 dots.
void draw_north(Tensor& picture, Index x, Index y, Index dot) {
  for (Index row = 0; row < 11; ++row) {
    const Index half = (row * 4) / 10;
    fill(picture, x + (4 - half) * dot, y + row * dot, (2 * half + 1) * dot, dot, kInk);
  }
  draw_text(picture, x + 11 * dot, y + 3 * dot, dot, "N");
}

}  // namespace

Index text_width(const std::string& text, Index size) {
  return text.empty() ? 0 : (6 * static_cast<Index>(text.size()) - 1) * size;
}

void draw_text(Tensor& picture, Index x, Index y, Index size, const std::string& text) {
  for (const char letter : text) {
    const auto code = static_cast<unsigned char>(letter);
    const std::size_t at = code >= ' ' && code <= 'z' ? code - ' ' : std::size_t{'?' - ' '};
    for (std::size_t column = 0; column < 5; ++column)
      for (Index row = 0; row < 8; ++row)
        if ((kFont[at][column] >> row & 1) != 0)
          fill(picture, x + static_cast<Index>(column) * size, y + row * size, size, size, kInk);
    x += 6 * size;
  }
}

Tensor with_legend(const Tensor& picture, const ColourScale* scale, double step) {
  Dims dim("with_legend");
  dim.match("picture", picture, "3 H W");
  const Index H = dim["H"], W = dim["W"];
  const Index dot = std::clamp<Index>(W / 300, 1, 12), margin = 6 * dot;
  const Index wide = std::max(
      {W, 170 * dot, scale == nullptr ? Index{0} : text_width(scale->title, dot) + 2 * margin});
  const Index strip = (scale == nullptr ? 0 : 35 * dot) + 13 * dot + 2 * margin;
  Tensor out({3, H + strip, wide}, 1.F);
  for (Index c = 0; c < 3; ++c)
    for (Index i = 0; i < H; ++i)
      std::copy_n(picture.data() + (c * H + i) * W, W, out.data() + (c * (H + strip) + i) * wide);
  fill(out, W, 0, wide - W, H, kPaper);
  Index y = H + margin;
  if (scale != nullptr) {
    draw_text(out, margin, y, dot, scale->title);
    draw_scale(out, *scale, margin, y + 11 * dot, wide - 2 * margin, dot);
    y += 35 * dot;
  }
  const double length = round_length(0.5 * static_cast<double>(W) * step);
  const auto px = static_cast<Index>(std::lround(length / step));
  fill(out, margin, y + 8 * dot, px, 2 * dot, kInk);
  fill(out, margin, y + 4 * dot, dot, 4 * dot, kInk);
  fill(out, margin + px - dot, y + 4 * dot, dot, 4 * dot, kInk);
  draw_text(out, margin + px + 4 * dot, y + 4 * dot, dot, length_text(length));
  draw_north(out, wide - margin - 16 * dot, y, dot);
  return out;
}

void write_map(const std::filesystem::path& path, const Tensor& picture, const ColourScale* scale,
               const rpc::GeoGrid& grid) {
  write_png(path, with_legend(picture, scale, grid.step));
  write_world_files(path, grid);
}

std::vector<std::filesystem::path> map_files(const std::filesystem::path& picture) {
  std::filesystem::path world = picture, crs = picture;
  world.replace_extension(".pgw");
  crs += ".aux.xml";
  return {picture, world, crs};
}

void write_world_files(const std::filesystem::path& path, const rpc::GeoGrid& grid) {
  const auto files = map_files(path);
  const std::filesystem::path &world = files[1], &crs = files[2];
  // a world file names the centre of the first pixel
  atomic_write(world, fmt::format("{0:.12g}\n0\n0\n{1:.12g}\n{2:.12g}\n{3:.12g}\n", grid.step,
                                  -grid.step, grid.x0 + grid.step / 2, grid.y0 - grid.step / 2));
  if (grid.epsg != 0)
    atomic_write(crs, "<PAMDataset>\n  <SRS>" + escaped(rpc::crs_wkt(grid.epsg)) +
                          "</SRS>\n</PAMDataset>\n");
  else
    std::filesystem::remove(crs);  // of a picture that was there before
}

}  // namespace satsurf::app

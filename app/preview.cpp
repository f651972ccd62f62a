// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/preview.h"

#include "satsurf/core/atomic_file.h"
#include "satsurf/core/dims.h"
#include "satsurf/core/error.h"
#include "satsurf/rpc/picture.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <string>
#include <vector>

namespace satsurf::app {
namespace {

constexpr float kGrey = 0.5f;

/// Value below which `share` of the finite elements lie.
float percentile(std::vector<float>& values, double share) {
  const auto at = static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1) + 0.5);
  std::nth_element(values.begin(), values.begin() + at, values.end());
  return values[static_cast<std::size_t>(at)];
}

using Colour = std::array<float, 3>;  // sRGB in [0, 1]

constexpr Colour colour_of(unsigned rgb) {
  const auto part = [&](unsigned shift) { return static_cast<float>(rgb >> shift & 0xffU) / 255; };
  return {part(16), part(8), part(0)};
}
template <std::size_t N>
std::vector<Colour> colours_of(const unsigned (&rgb)[N]) {
  std::vector<Colour> out;
  for (const unsigned c : rgb) out.push_back(colour_of(c));
  return out;
}

// Every sixteenth of the maps of matplotlib by S. van der Walt and N. Smith, which they gave to all (CC0).
const std::vector<Colour> kViridis = colours_of(
    {0x440154, 0x48186a, 0x472d7b, 0x424086, 0x3b528b, 0x33638d, 0x2c728e, 0x26828e, 0x21918c,
     0x1fa088, 0x28ae80, 0x3fbc73, 0x5ec962, 0x84d44b, 0xaddc30, 0xd8e219, 0xfde725});
const std::vector<Colour> kMagma = colours_of(
    {0x000004, 0x0a0822, 0x1d1147, 0x36106b, 0x51127c, 0x6a1c81, 0x832681, 0x9c2e7f, 0xb73779,
     0xd0416f, 0xe75263, 0xf56b5c, 0xfc8961, 0xfea772, 0xfec488, 0xfde2a3, 0xfcfdbf});
const std::vector<Colour> kInferno = colours_of(
    {0x000004, 0x0b0724, 0x210c4a, 0x3d0965, 0x57106e, 0x71196e, 0x8a226a, 0xa32c61, 0xbc3754,
     0xd24644, 0xe45a31, 0xf1731d, 0xf98e09, 0xfcac11, 0xf9cb35, 0xf2ea69, 0xfcffa4});
// blue - white - red, equally light at both ends
const std::vector<Colour> kErrors{{0.02f, 0.19f, 0.55f},
                                  {0.40f, 0.62f, 0.90f},
                                  {0.97f, 0.97f, 0.97f},
                                  {0.95f, 0.55f, 0.40f},
                                  {0.60f, 0.02f, 0.10f}};
const std::vector<Colour>&kHeights = kViridis, &kConfidence = kMagma, &kSigma = kInferno,
      &kCounts = kViridis;

/// The colour of a share of a map.
Colour colour_at(const std::vector<Colour>& map, float share) {
  const float at = std::clamp(share, 0.f, 1.f) * static_cast<float>(map.size() - 1);
  const std::size_t k = std::min(static_cast<std::size_t>(at), map.size() - 2);
  const float beyond = at - static_cast<float>(k);
  Colour out;
  for (std::size_t c = 0; c < 3; ++c) out[c] = (1 - beyond) * map[k][c] + beyond * map[k + 1][c];
  return out;
}

/// Colours [H W] values that are already scaled to [0, 1]; grey where there is none.
Tensor coloured(const char* where, const Tensor& unit, const std::vector<Colour>& map) {
  Dims dim(where);
  dim.match("map", unit, "H W");
  const Index H = dim["H"], W = dim["W"], P = H * W;
  Tensor out({3, H, W}, kGrey);
  for (Index i = 0; i < P; ++i) {
    if (!std::isfinite(unit[i])) continue;
    const Colour colour = colour_at(map, unit[i]);
    for (Index c = 0; c < 3; ++c) out[c * P + i] = colour[static_cast<std::size_t>(c)];
  }
  return out;
}

/// The colours of a map, low to high.
std::vector<Colour> ramp(const std::vector<Colour>& map) {
  constexpr int kColours = 33;
  std::vector<Colour> out;
  for (int i = 0; i < kColours; ++i)
    out.push_back(colour_at(map, static_cast<float>(i) / static_cast<float>(kColours - 1)));
  return out;
}

/// Values as shares of a scale.
Tensor scaled(const Tensor& values, double low, double high) {
  Tensor unit = values.clone();
  const auto from = static_cast<float>(low), span = static_cast<float>(high - low);
  for (float& v : unit.values()) v = (v - from) / span;
  return unit;
}

std::vector<float> known_of(const Tensor& values) {
  std::vector<float> known;
  for (const float v : values.values())
    if (std::isfinite(v)) known.push_back(v);
  return known;
}

/// The bytes of a picture's file.
std::string encoded(const std::string& where, const Tensor& picture, rpc::PictureFormat format) {
  const bool one = picture.rank() == 2;
  Dims dim(where);
  dim.match("picture", picture, one ? "H W" : "3 H W");
  const Index H = dim["H"], W = dim["W"], C = one ? 1 : 3, P = H * W;
  if (P == 0)
    throw ShapeError(where + ": picture has shape " + picture.shape().str() + ", expected pixels");
  std::vector<std::uint8_t> bytes(static_cast<std::size_t>(C * P));
  for (Index i = 0; i < P; ++i)
    for (Index c = 0; c < C; ++c) {
      const float v = picture[c * P + i];
      bytes[static_cast<std::size_t>(i * C + c)] = static_cast<std::uint8_t>(
          255 * (std::isfinite(v) ? std::clamp(v, 0.f, 1.f) : kGrey) + 0.5f);
    }
  return rpc::encoded_picture(where, bytes, H, W, C, format);
}

}  // namespace

ColourScale height_scale(const Tensor& z, double h0) {
  std::vector<float> known = known_of(z);
  ColourScale scale{
      "m above the ellipsoid; 2 % beyond each end", h0, h0 + 1, true, true, ramp(kHeights)};
  if (known.empty()) return scale;
  const auto low = static_cast<double>(percentile(known, 0.02)),
             high = static_cast<double>(percentile(known, 0.98));
  scale.low = low + h0;
  scale.high = std::max(high, low + 1e-3) + h0;  // a flat surface has one colour
  return scale;
}

ColourScale confidence_scale() { return {"confidence", 0, 1, false, false, ramp(kConfidence)}; }

ColourScale sigma_scale(const Tensor& sigma) {
  std::vector<float> known = known_of(sigma);
  const double high = known.empty() ? 1 : static_cast<double>(percentile(known, 0.98));
  return {"expected error, m", 0, std::max(high, 1e-3), false, true, ramp(kSigma)};
}

std::vector<std::array<float, 3>> count_colours(Index most) {
  Tensor counts({1, most + 1});
  for (Index n = 0; n <= most; ++n) counts[n] = static_cast<float>(n);
  const Tensor rgb = count_picture(counts, most);
  std::vector<std::array<float, 3>> out;
  for (Index n = 0; n <= most; ++n)
    out.push_back({rgb[n], rgb[most + 1 + n], rgb[2 * (most + 1) + n]});
  return out;
}

ColourScale error_scale(double limit) {
  return {"error, m: blue too low, red too high", -limit, limit, true, true, ramp(kErrors)};
}

Tensor block_means(const Tensor& values, Index block) {
  const bool planes = values.rank() == 3;
  const Index C = planes ? values.dim(0) : 1, H = values.dim(planes ? 1 : 0),
              W = values.dim(planes ? 2 : 1), h = (H + block - 1) / block,
              w = (W + block - 1) / block;
  Tensor out(planes ? Shape{C, h, w} : Shape{h, w}, std::numeric_limits<float>::quiet_NaN());
  for (Index c = 0; c < C; ++c)
    for (Index y = 0; y < h; ++y)
      for (Index x = 0; x < w; ++x) {
        double sum = 0, count = 0;
        for (Index v = y * block; v < std::min(H, (y + 1) * block); ++v)
          for (Index u = x * block; u < std::min(W, (x + 1) * block); ++u)
            if (const float value = values[(c * H + v) * W + u]; std::isfinite(value))
              sum += static_cast<double>(value), count += 1;
        if (count > 0) out[(c * h + y) * w + x] = static_cast<float>(sum / count);
      }
  return out;
}

Tensor stretched_picture(const Tensor& picture) {
  constexpr double kLeastSpan = 0.05;  // of a picture of one colour no noise is to be made visible
  std::vector<float> known = known_of(picture);
  if (known.empty()) return picture.clone();
  const auto low = static_cast<double>(percentile(known, 0.01)),
             high = static_cast<double>(percentile(known, 0.99));
  Tensor out = scaled(picture, low, std::max(high, low + kLeastSpan));
  for (float& v : out.values())
    if (std::isfinite(v)) v = std::clamp(v, 0.F, 1.F);
  return out;
}

Tensor height_picture(const Tensor& z) {
  const ColourScale scale = height_scale(z, 0);
  return coloured("height_picture", scaled(z, scale.low, scale.high), kHeights);
}

Tensor hillshade_picture(const Tensor& z, double step) {
  Dims dim("hillshade_picture");
  dim.match("z", z, "H W");
  const Index H = dim["H"], W = dim["W"], P = H * W;
  const double elevation = 45 * M_PI / 180, azimuth = 315 * M_PI / 180;
  const double sun[3] = {std::cos(elevation) * std::sin(azimuth),
                         std::cos(elevation) * std::cos(azimuth), std::sin(elevation)};
  Tensor out({3, H, W}, kGrey);
  for (Index i = 0; i < H; ++i)
    for (Index j = 0; j < W; ++j) {
      const float centre = z[i * W + j];
      if (!std::isfinite(centre)) continue;
      double q[3][3];
      for (Index r = 0; r < 3; ++r)
        for (Index c = 0; c < 3; ++c) {
          const Index y = std::clamp<Index>(i + r - 1, 0, H - 1),
                      x = std::clamp<Index>(j + c - 1, 0, W - 1);
          const float v = z[y * W + x];
          q[r][c] = static_cast<double>(std::isfinite(v) ? v : centre);
        }
      const double dx =
          (q[0][2] + 2 * q[1][2] + q[2][2] - q[0][0] - 2 * q[1][0] - q[2][0]) / (8 * step);
      const double dy =
          (q[0][0] + 2 * q[0][1] + q[0][2] - q[2][0] - 2 * q[2][1] - q[2][2]) / (8 * step);
      const double lit = (sun[2] - dx * sun[0] - dy * sun[1]) / std::sqrt(1 + dx * dx + dy * dy);
      const auto shade = static_cast<float>(std::clamp(0.08 + 0.92 * std::max(0.0, lit), 0.0, 1.0));
      for (Index c = 0; c < 3; ++c) out[c * P + i * W + j] = shade;
    }
  return out;
}

Tensor confidence_picture(const Tensor& confidence) {
  return coloured("confidence_picture", confidence, kConfidence);
}

Tensor sigma_picture(const Tensor& sigma) {
  return coloured("sigma_picture", scaled(sigma, 0, sigma_scale(sigma).high), kSigma);
}

Tensor count_picture(const Tensor& views, Index most) {
  return coloured("count_picture", scaled(views, 0, static_cast<double>(std::max<Index>(most, 1))),
                  kCounts);
}

Tensor error_picture(const Tensor& error, double limit) {
  return coloured("error_picture", scaled(error, -limit, limit), kErrors);
}

std::string png_bytes(const Tensor& picture) {
  return encoded("png_bytes", picture, rpc::PictureFormat::png);
}

std::string jpeg_bytes(const Tensor& picture) {
  return encoded("jpeg_bytes", picture, rpc::PictureFormat::jpeg);
}

void write_png(const std::filesystem::path& path, const Tensor& picture) {
  atomic_write(path, encoded("write_png: " + path.string(), picture, rpc::PictureFormat::png));
}

}  // namespace satsurf::app
